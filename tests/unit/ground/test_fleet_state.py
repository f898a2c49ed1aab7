"""The ground's fold over status reports."""

from __future__ import annotations

from math import inf, pi, sqrt

import pytest

from common import with_fields
from companion.ground.fleet_state import MOST_VEHICLES, SILENT_AFTER_S, FleetState, flown_reference, fold, vehicles_at
from companion.types.autopilot import LandedState
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, Heading, HeldReference, LeaderBeacon
from companion.types.status import Status
from companion.types.values import Vector3
from companion.wire.messages import StatusReport
from ground_fleet import STATUS as REPORTED_STATUS
from ground_fleet import TIMING

STATUS = with_fields(
    REPORTED_STATUS,
    position_enu_m=(0.0, 0.0, 1.0),
    velocity_enu_m_s=(0.0, 0.0, 0.0),
    neighbours=(),
    last_event=None,
    holder="",
)


def leader(reference_enu_m: Vector3 = (1.0, 0.0, 1.0), **changes: object) -> Status:
    changes = {"role": Role.LEADER, "prc": 1, "reference_enu_m": reference_enu_m} | changes
    return with_fields(STATUS, **changes)


def follower(vehicle_id: int, **changes: object) -> Status:
    return with_fields(STATUS, vehicle_id=vehicle_id, **changes)


def received(*statuses: Status, at_s: float = 100.0, state: FleetState | None = None) -> FleetState:
    state = state or FleetState()
    for status in statuses:
        state = fold(state, StatusReport(status, TIMING), at_s)
    return state


def error_of(state: FleetState, vehicle_id: int, now_s: float = 100.1) -> float | None:
    return next(row.error_to_slot_m for row in vehicles_at(state, now_s) if row.vehicle_id == vehicle_id)


def test_no_report_is_an_empty_table() -> None:
    assert vehicles_at(FleetState(), 0.0) == []


def test_the_error_is_the_distance_from_slot_and_reference_together() -> None:
    """|(x - d) - r| worked by hand: ((-1, 0.5, 1) - (-1.5, 0, 0)) - (1, 0, 1) = (-0.5, 0.5, 0)."""
    state = received(leader(), follower(2, position_enu_m=(-1.0, 0.5, 1.0), slot=FlownSlot((-1.5, 0.0, 0.0))))
    assert error_of(state, 1) == pytest.approx(1.0)
    assert error_of(state, 2) == pytest.approx(sqrt(0.5))


def test_a_slot_turns_with_its_formation() -> None:
    """Two metres behind, to the north."""
    turned = follower(2, position_enu_m=(1.0, -2.0, 1.0), slot=FlownSlot((-2.0, 0.0, 0.0)), heading=Heading(pi / 2.0))
    assert error_of(received(leader(), turned), 2) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("landed", "known"),
    [
        (LandedState.UNDEFINED, False),
        (LandedState.ON_GROUND, False),
        (LandedState.IN_AIR, True),
        (LandedState.TAKEOFF, True),
        (LandedState.LANDING, True),
    ],
)
def test_a_vehicle_that_does_not_fly_has_no_error(landed: LandedState, known: bool) -> None:
    assert (error_of(received(leader(), follower(2, landed=landed)), 2) is not None) is known


def test_without_a_leader_no_vehicle_has_an_error() -> None:
    assert error_of(received(follower(2)), 2) is None


def test_a_silent_leader_gives_no_reference() -> None:
    state = received(follower(2), at_s=102.0, state=received(leader(), at_s=100.0))
    assert error_of(state, 2, now_s=102.0) is None


def test_the_leader_of_another_fleet_gives_no_reference() -> None:
    assert error_of(received(leader(fleet="other"), follower(2)), 2) is None


def test_of_two_leaders_that_of_the_leader_beacon_gives_the_reference() -> None:
    state = received(
        leader((10.0, 0.0, 1.0)),
        leader((20.0, 0.0, 1.0), vehicle_id=5),
        follower(2, leader_beacon=LeaderBeacon(5, 0, 100)),
        follower(3),
        follower(4, leader_beacon=LeaderBeacon(77, 0, 100)),
    )
    assert error_of(state, 2) == pytest.approx(20.0)
    assert error_of(state, 3) == pytest.approx(10.0)
    assert error_of(state, 4) == pytest.approx(10.0)
    assert error_of(state, 5) == pytest.approx(20.0)


def test_a_silent_vehicle_is_shown_with_its_age_and_stays() -> None:
    state = received(leader(), follower(2), at_s=100.0)
    state = received(leader(), at_s=99_999.0, state=state)
    talking, silent = vehicles_at(state, 100_000.0)
    assert (talking.vehicle_id, talking.silent) == (1, True is False)
    assert (silent.vehicle_id, silent.silent) == (2, True)
    assert silent.age_s == pytest.approx(99_900.0)
    assert silent.error_to_slot_m is None


@pytest.mark.parametrize(("age_s", "silent"), [(0.0, False), (SILENT_AFTER_S, False), (SILENT_AFTER_S + 1e-6, True)])
def test_silence_begins_after_one_second(age_s: float, silent: bool) -> None:
    assert vehicles_at(received(leader(), at_s=0.0), age_s)[0].silent is silent


def test_unknown_vehicles_fill_no_memory_and_displace_no_vehicle() -> None:
    state = received(leader())
    for i in range(2 * MOST_VEHICLES):
        state = received(leader(fleet=f"f{i}"), at_s=100.1, state=state)
    assert len(state.vehicles) == MOST_VEHICLES
    assert (leader().agent.fleet, leader().agent.vehicle_id) in state.vehicles
    state = received(leader(fleet="late"), at_s=102.0, state=state)
    assert len(state.vehicles) == MOST_VEHICLES
    assert ("late", 1) in state.vehicles


def test_data_age_includes_the_age_on_board() -> None:
    state = received(leader(state_age_s=0.4), follower(2, state_age_s=inf), at_s=100.0)
    first, second = vehicles_at(state, 100.1)
    assert first.age_s == pytest.approx(0.1)
    assert first.data_age_s == pytest.approx(0.5)
    assert second.data_age_s == inf


def test_the_newest_report_counts_and_the_fold_leaves_the_old_state_alone() -> None:
    before = received(leader())
    after = received(leader(rejected={"malformed": 2, "another": 3}, phase=FlightPhase.LAND), state=before)
    assert vehicles_at(before, 100.0)[0].rejected == 0
    assert vehicles_at(after, 100.0)[0].rejected == 5
    assert vehicles_at(after, 100.0)[0].status.phase is FlightPhase.LAND
    assert len(vehicles_at(after, 100.0)) == 1


def test_rows_come_by_fleet_and_id() -> None:
    state = received(follower(10), follower(9), leader(fleet="alpha", vehicle_id=11))
    assert [(row.fleet, row.vehicle_id) for row in vehicles_at(state, 100.0)] == [
        ("alpha", 11),
        ("platoon", 9),
        ("platoon", 10),
    ]


@pytest.mark.parametrize(
    ("phase", "shown"),
    [
        (FlightPhase.OBSERVE, ()),
        (FlightPhase.ARMED, ()),
        (FlightPhase.TAKEOFF, ()),
        (FlightPhase.HOLD, (HealthFlag.LEADER_LOST,)),
        (FlightPhase.FORMATION, (HealthFlag.LEADER_LOST,)),
    ],
)
def test_a_missing_leader_is_shown_only_during_a_flight(phase: FlightPhase, shown: tuple[HealthFlag, ...]) -> None:
    waiting = follower(2, phase=FlightPhase.OBSERVE, flags=(HealthFlag.LEADER_LOST,))
    other_fleet = follower(3, fleet="other", phase=FlightPhase.OBSERVE, flags=(HealthFlag.LEADER_LOST,))
    table = vehicles_at(received(follower(1, phase=phase), waiting, other_fleet), 100.0)
    assert {row.vehicle_id: row.flags for row in table} == {1: (), 2: shown, 3: ()}


def test_a_silent_vehicle_is_no_flight_and_other_flags_are_always_shown() -> None:
    flags = (HealthFlag.LEADER_LOST, HealthFlag.MODE_STALE)
    state = received(follower(1), at_s=100.0)
    state = received(follower(2, phase=FlightPhase.OBSERVE, flags=flags), at_s=110.0, state=state)
    assert vehicles_at(state, 110.0)[1].flags == (HealthFlag.MODE_STALE,)


def test_a_described_reference_holds_until_another_one_is_flown() -> None:
    circle, held = {"kind": "circle", "radius_m": 4.0}, HeldReference(flown=2, waiting=2, begun_s=10.0)
    state = received(leader(described=circle, reference=held), follower(2, described={"kind": "point"}))
    fleet = STATUS.agent.fleet
    assert flown_reference(state, fleet) == circle
    later = received(leader(reference=HeldReference(2, 3, 10.0)), at_s=101.0, state=state)  # another one waits
    assert flown_reference(later, fleet) == circle
    assert flown_reference(later, "other") is None
    for other in (
        leader(reference=HeldReference(3, 3, 30.0)),
        leader(reference=HeldReference(2, 2, 0.0)),  # after a landing
        leader(reference=held, session=99),
    ):
        assert flown_reference(received(other, at_s=101.0, state=state), fleet) is None
    follows = received(leader(reference=held, role=Role.FOLLOWER), leader(vehicle_id=3), at_s=101.0, state=state)
    assert flown_reference(follows, fleet) is None
