"""Vehicles that leave a column of five and join it again, in virtual time."""

from __future__ import annotations

import numpy as np
import pytest

from common import ROOT
from companion.ground.changes import change_to, reference_change
from companion.types.commands import CommandName, Lead
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from lockstep_fleet import JUMP_M, CommandedFlight
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress

SCENARIO = ROOT / "config" / "scenarios" / "leaving.yaml"
OTHERS = (1, 2, 4, 5)
KEEP_GAP = "fleet.when_one_leaves=keep_gap"
IT_STANDS_FIRST = (
    "reference={kind: waypoints, points_enu_m: [[0, 0, 2], [0, 0.001, 2], [14, 0, 2]], wait_s: 45,"
    " max_speed_m_s: 1.0, max_acceleration_m_s2: 0.5}"
)


def goes_on(speed_m_s: float) -> str:
    """The column moves 14 m ahead."""
    way = "kind: waypoints, points_enu_m: [[0, 0, 2], [14, 0, 2]]"
    return f"reference={{{way}, max_speed_m_s: {speed_m_s}, max_acceleration_m_s2: 0.5}}"


def flight(*overrides: str) -> CommandedFlight:
    return CommandedFlight(SCENARIO, *overrides)


def test_a_vehicle_that_left_is_no_neighbour_and_the_others_continue() -> None:
    fleet = flight(KEEP_GAP, goes_on(1.0))
    fleet.give(CommandName.HOLD, 3)
    fleet.go_on(16.0)  # 14 m further
    assert {fleet.newest[i].phase for i in OTHERS} == {FlightPhase.FORMATION}
    assert fleet.newest[3].phase is FlightPhase.HOLD
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.newest[3].motion.position_enu_m[0] < -2.0


def test_a_vehicle_rejoins_its_gap_without_disturbing_the_others() -> None:
    fleet = flight(KEEP_GAP)
    fleet.land(3)
    fleet.take_off_again(3)
    since_s = fleet.lockstep.now_s()
    fleet.give(CommandName.FORM, 3)
    fleet.until(3, FlightPhase.FORMATION)
    fleet.go_on(12.0)
    assert max(fleet.errors_m().values()) < 0.1
    assert len(fleet.errors_m()) == 5
    assert "has joined: it is in its slot" in fleet.events_of(3)
    assert fleet.smallest_m(since_s) > 1.9


@pytest.mark.parametrize("moving", [pytest.param(False, marks=pytest.mark.long), True])
def test_a_vehicle_joins_from_a_distance_and_the_others_keep_their_slots(moving: bool) -> None:
    """The vehicle is behind the column, which has moved ahead or is moving."""
    fleet = flight(goes_on(0.6 if moving else 3.0))
    fleet.land(5)
    fleet.take_off_again(5)
    since_s = fleet.lockstep.now_s()
    slots = {i: status.formation.slot.position_enu_m for i, status in fleet.newest.items()}
    far_m = fleet.newest[4].motion.position_enu_m[0] - 2.0 - fleet.newest[5].motion.position_enu_m[0]
    assert far_m > 2.0
    fleet.give(CommandName.FORM, 5)
    fleet.until(5, FlightPhase.FORMATION)
    worst_m = 0.0
    for _ in range(60):
        fleet.go_on(0.5)
        worst_m = max(worst_m, *fleet.errors_m().values())
    assert worst_m < 0.35
    assert {i: status.formation.slot.position_enu_m for i, status in fleet.newest.items()} == slots
    assert fleet.smallest_m(since_s) > 1.8
    assert fleet.decisions.jump_m() < JUMP_M


def test_a_path_too_close_to_another_vehicle_is_refused_with_its_id() -> None:
    fleet = flight(KEEP_GAP, goes_on(3.0))
    fleet.land(3)
    fleet.take_off_again(3)
    fleet.go_on(5.0)
    reply = fleet.answers(CommandName.FORM, 3)[3]
    assert reply is not None
    assert not reply.accepted
    assert reply.code is Code.PATH_TOO_CLOSE
    assert reply.reason.endswith("m of vehicle 4; expected at least separation_m, 1 m")
    assert fleet.newest[3].phase is FlightPhase.HOLD


def test_joining_is_refused_during_a_formation_change() -> None:
    fleet = flight(KEEP_GAP)
    fleet.land(5)
    fleet.take_off_again(5)
    nearer = change_to({i: (-1.8 * (i - 1), 0.0, 0.0) for i in range(1, 6)}, list(fleet.newest.values()), 1.0)
    fleet.give(CommandName.FORMATION, content=nearer)
    reply = fleet.answers(CommandName.FORM, 5)[5]
    assert reply is not None
    assert reply.code is Code.PEER_STILL_JOINING
    fleet.go_on(10.0)
    fleet.give(CommandName.FORM, 5)
    fleet.go_on(5.0)
    assert np.isclose(fleet.newest[5].formation.slot.position_enu_m[0], -7.2)


def test_a_vehicle_with_low_battery_lands_and_the_others_continue() -> None:
    drains = "stand_in.batteries=[{vehicle: 4, at_s: 30, percent: 14}, {vehicle: 5, at_s: 30, percent: -1}]"
    fleet = flight(KEEP_GAP, "fleet.leave_below_percent=15", drains)
    assert fleet.lockstep.now_s() < 29.0
    fleet.go_on(30.0 - fleet.lockstep.now_s() + 2.5)
    assert fleet.newest[4].phase is FlightPhase.FORMATION  # it may be a wrong sample yet
    fleet.until(4, FlightPhase.OBSERVE)
    assert not fleet.newest[4].autopilot.armed
    assert "formation -> release (battery below leave_below_percent)" in fleet.events_of(4)
    assert "hold -> land (battery below leave_below_percent)" in fleet.events_of(4)
    assert {fleet.newest[i].phase for i in (1, 2, 3, 5)} == {FlightPhase.FORMATION}
    assert max(fleet.errors_m().values()) < 0.1


def test_the_successor_replaces_a_leader_that_leaves() -> None:
    fleet = flight(KEEP_GAP, "fleet.leave_below_percent=15", "stand_in.batteries=[{vehicle: 1, at_s: 26, percent: 9}]")
    fleet.until(1, FlightPhase.OBSERVE)
    assert fleet.newest[2].leadership.role is Role.LEADER
    fleet.go_on(20.0)
    assert {fleet.newest[i].phase for i in (2, 3, 4, 5)} == {FlightPhase.FORMATION}
    assert {status.formation.slot.formation for status in fleet.newest.values()} == {0}
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.decisions.jump_m() < JUMP_M


def test_the_column_fills_the_gap_and_the_vehicle_joins_at_its_end() -> None:
    fleet = flight(IT_STANDS_FIRST)
    since_s = fleet.lockstep.now_s()
    fleet.land(3)
    assert {fleet.newest[i].formation.slot.formation for i in OTHERS} == {
        0
    }  # vehicle 3 was in the air beside their paths
    kept = "vehicle 3 left, its gap is kept for now: it may still be in the air"
    assert any(event.startswith(kept) for event in fleet.events_of(1))
    fleet.go_on(15.0)
    assert any(event.startswith("closes the gap of vehicle 3: formation 1 begins in") for event in fleet.events_of(1))
    xs = {i: status.formation.slot.position_enu_m[0] for i, status in fleet.newest.items()}
    assert xs == {1: 0.0, 2: -2.0, 4: -4.0, 5: -6.0, 3: -8.0}  # also on the ground
    assert max(fleet.errors_m().values()) < 0.1
    reply = fleet.answers(CommandName.PREPARE, 3)[3]
    assert reply is not None
    assert reply.accepted
    fleet.until(3, FlightPhase.READY)
    reply = fleet.answers(CommandName.ARM, 3)[3]  # another hovers above it now
    assert reply is not None
    assert reply.code is Code.VEHICLE_TOO_CLOSE
    fleet.go_on(40.0)  # the column is 14 m away
    fleet.give(CommandName.DISARM, 3)
    fleet.go_on(1.0)
    fleet.take_off_again(3)
    fleet.give(CommandName.FORM, 3)
    worst_m = 0.0
    for _ in range(50):
        fleet.go_on(0.5)
        worst_m = max(worst_m, *fleet.errors_m().values())
    assert "has joined: it is in its slot" in fleet.events_of(3)
    assert {i: status.formation.slot.position_enu_m[0] for i, status in fleet.newest.items()} == xs
    assert {status.formation.slot.formation for status in fleet.newest.values()} == {1}
    assert worst_m < 0.3  # as reported, at up to 1.9 m/s and at different times
    assert fleet.decisions.jump_m() < JUMP_M
    assert fleet.smallest_m(since_s) > 1.7  # true distances, in the air and on the ground


@pytest.mark.parametrize("overrides", [(), pytest.param((KEEP_GAP,), marks=pytest.mark.long)])
def test_the_gap_is_kept_while_the_vehicle_holds_in_it(overrides: tuple[str, ...]) -> None:
    fleet = flight(*overrides)
    fleet.give(CommandName.HOLD, 3)
    fleet.go_on(10.0)
    assert {status.formation.slot.formation for status in fleet.newest.values()} == {0}
    fleet.give(CommandName.FORM, 3)
    fleet.go_on(8.0)
    assert {status.phase for status in fleet.newest.values()} == {FlightPhase.FORMATION}
    assert "has joined: it is in its slot" in fleet.events_of(3)
    assert max(fleet.errors_m().values()) < 0.1


def test_a_leader_that_landed_restarts_the_reference_with_the_same_formation() -> None:
    fleet = flight(KEEP_GAP, "fleet.successors=[]")
    abreast = {i: (0.0, -2.0 * (i - 1), 0.0) for i in range(1, 6)}
    fleet.give(CommandName.FORMATION, content=change_to(abreast, list(fleet.newest.values()), 1.0))
    fleet.go_on(24.0)
    assert all(np.allclose(status.formation.slot.position_enu_m, abreast[i]) for i, status in fleet.newest.items())
    fleet.land(1)
    assert {fleet.newest[i].phase for i in (2, 3, 4, 5)} == {FlightPhase.HOLD}
    fleet.take_off_again(1)
    fleet.go_on(1.0)
    since_s = fleet.lockstep.now_s()
    fleet.give(CommandName.FORM)
    for _ in range(16):
        fleet.go_on(0.5)
        assert all(np.allclose(status.formation.slot.position_enu_m, abreast[i]) for i, status in fleet.newest.items())
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.smallest_m(since_s) > 1.8


@pytest.mark.parametrize("landed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_two_leaders_have_one_reference_time_after_one_landed(landed: int) -> None:
    fleet = flight(KEEP_GAP, goes_on(0.5))
    fleet.give(CommandName.LEAD, content=Lead((1, 2), 1))
    fleet.go_on(4.0)
    fleet.give(CommandName.HOLD)
    fleet.go_on(1.0)
    fleet.land(landed)
    fleet.take_off_again(landed)
    fleet.go_on(1.0)
    fleet.give(CommandName.FORM)
    fleet.go_on(3.0)
    assert fleet.newest[1].leadership.role is fleet.newest[2].leadership.role is Role.LEADER
    times_s = [status.formation.reference_s for status in fleet.newest.values()]
    assert max(times_s) - min(times_s) < 0.2
    before_s = 10.0
    assert (times_s[0] < before_s) is (landed == 1)


def test_a_restarted_second_leader_forms_only_with_the_reference_of_the_first() -> None:
    fleet = flight(KEEP_GAP, "fleet.vehicles[1].role=leader", "fleet.successors=[]")
    circle = {"kind": "circle", "centre_enu_m": [0.0, 3.0, 2.0], "radius_m": 3.0, "period_s": 40.0}
    change = reference_change(circle, list(fleet.newest.values()))
    fleet.give(CommandName.REFERENCE, 1, 2, content=change)
    fleet.go_on(3.0)
    fleet.give(CommandName.HOLD, 2)
    fleet.until(2, FlightPhase.HOLD)
    in_order = fleet.lockstep.in_order
    fleet.lockstep.in_order = [vehicle for vehicle in in_order if vehicle.vehicle_id != 2]
    fleet.go_on(1.0)
    fleet.restart(2)
    fleet.lockstep.in_order, fleet.lockstep.vehicles[2].session = in_order, 2
    fleet.go_on(1.0)
    fleet.give(CommandName.HOLD, 2)
    fleet.until(2, FlightPhase.HOLD)
    reply = fleet.answers(CommandName.FORM, 2)[2]
    assert reply is not None
    assert not reply.accepted
    assert reply.code is Code.REFERENCE_DIFFERS
    fleet.give(CommandName.REFERENCE, 2, content=change)
    fleet.give(CommandName.FORM, 2)
    fleet.go_on(3.0)
    assert fleet.newest[2].formation.reference == fleet.newest[1].formation.reference


def test_a_commanded_formation_has_priority_over_gap_filling() -> None:
    fleet = flight()
    fleet.land(3)
    while not any("closes the gap" in event for event in fleet.events_of(1)):
        fleet.go_on(0.1)
    wider = {i: (-2.2 * (i - 1), 0.0, 0.0) for i in range(1, 6)}
    change = change_to(wider, list(fleet.newest.values()), 1.0)
    fleet.give(CommandName.FORMATION, *OTHERS, content=change)
    fleet.go_on(change.lasts_s + 1.2)
    assert {i: fleet.newest[i].formation.slot.position_enu_m for i in OTHERS} == {i: wider[i] for i in OTHERS}
    fleet.go_on(20.0)  # and then
    assert [fleet.newest[i].formation.slot.position_enu_m[0] for i in (1, 2, 4, 5, 3)] == [
        wider[i][0] for i in range(1, 6)
    ]


def test_the_successor_of_a_leader_that_left_fills_its_gap() -> None:
    fleet = flight()
    since_s = fleet.lockstep.now_s()
    fleet.land(1)
    fleet.go_on(20.0)
    assert fleet.newest[2].leadership.role is Role.LEADER
    assert [fleet.newest[i].formation.slot.position_enu_m[0] for i in (2, 3, 4, 5, 1)] == [0.0, -2.0, -4.0, -6.0, -8.0]
    assert max(fleet.errors_m().values()) < 0.1
    assert fleet.decisions.jump_m() < JUMP_M
    assert fleet.smallest_m(since_s) > 1.6


def test_the_gap_is_filled_over_a_bad_network_with_noise() -> None:
    fleet = flight("stand_in.sensors=default", "links.peer_loss=0.2", "links.peer_delay_s=0.05")
    since_s = fleet.lockstep.now_s()
    fleet.land(3)
    fleet.go_on(25.0)
    assert [fleet.newest[i].formation.slot.position_enu_m[0] for i in (1, 2, 4, 5, 3)] == [0.0, -2.0, -4.0, -6.0, -8.0]
    assert {fleet.newest[i].phase for i in OTHERS} == {FlightPhase.FORMATION}
    assert fleet.smallest_m(since_s) > 1.4


# In `make test` the tests of true tracks fly it, with ArduCopter.
@pytest.mark.long
@pytest.mark.parametrize("autopilot", ["px4", "ardupilot"])
def test_the_scenario_is_flown_completely(autopilot: str) -> None:
    scenario = load_scenario(SCENARIO, [f"stand_in.autopilot={autopilot}"])
    flight = fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))
    assert flight.failure is None
    events = [event.event for event in flight.watch.events]
    assert any(event.startswith("closes the gap of vehicle 3") for event in events)
    assert "has joined: it is in its slot" in events
    assert len(flight.watch.formations) == 2
