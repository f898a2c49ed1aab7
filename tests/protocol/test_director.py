"""The director in real time, with vehicles that accept, refuse, fall back and fall silent, without any process."""

import dataclasses
import time

import pytest
from msgspec.structs import replace

from companion.config.reference import PointReference
from companion.types.commands import CommandName, Lead, ReferenceChange
from companion.types.flight import Role
from companion.types.formation import HeldReference
from companion.types.notices import Code, Notice
from ground_fleet import DIRECTED_TIMING, DOING_S, WHOLE, C, DirectedFlight, P
from sitl.flight import director
from sitl.flight.orders import FlightFailure
from sitl.flight.scenario import FormationStep, TimelineStep
from sitl.report.vehicle_table import row as row_of


@pytest.fixture
def flight() -> DirectedFlight:
    return DirectedFlight()


def event_of(text: str) -> Notice:
    return Notice(Code.PHASE_CHANGED, text)


def test_a_whole_timeline_is_flown_and_the_formation_is_timed(flight: DirectedFlight) -> None:
    flight.fly(*WHOLE)
    assert [name for name, _ in flight.vehicles.received] == list(WHOLE)
    formation = flight.watch.formation
    assert formation is not None
    # The last vehicle enters 0.1 s after the command, the leader 0.05 s before it; the clock starts with the last.
    assert formation.end_s - formation.start_s == pytest.approx(0.3, abs=0.1)
    assert formation.start_s - formation.reference_start_s == pytest.approx(DOING_S, abs=0.03)
    assert flight.watch.timing == {1: DIRECTED_TIMING, 2: DIRECTED_TIMING}
    assert flight.director.land_all() is None
    assert flight.vehicles.received[-1][0] is C.LAND  # no command was repeated


def test_a_refused_command_is_repeated_to_the_refusing_vehicles(flight: DirectedFlight) -> None:
    flight.vehicles.refuses[2, C.ARM] = ["arm: not ready", "arm: still not ready"]
    flight.fly(C.PREPARE, C.ARM, timeout_s=5.0)
    assert flight.vehicles.received == [(C.PREPARE, (1, 2)), (C.ARM, (1, 2)), (C.ARM, (2,)), (C.ARM, (2,))]


def test_a_vehicle_that_never_accepts_is_named_with_its_last_reason(flight: DirectedFlight) -> None:
    flight.vehicles.refuses[2, C.ARM] = ["first", *["arm: the autopilot's origin is unknown"] * 20]
    message = flight.fails(C.PREPARE, C.ARM, timeout_s=1.2)
    assert message == "arm not done within 1.2 s: vehicle 2: WRONG_PHASE: arm: the autopilot's origin is unknown"


def test_vehicles_with_the_same_reason_are_reported_together(flight: DirectedFlight) -> None:
    flight.vehicles.mute = {1, 2}
    message = flight.fails(C.PREPARE, timeout_s=0.2)
    assert message == "prepare not done within 0.2 s: vehicles 1, 2: no answer from its agent"


def test_a_procedure_that_fails_on_the_ground_is_tried_again(flight: DirectedFlight) -> None:
    flight.vehicles.falls[1, C.ARM] = "arm -> ready (arm failed: no)"
    message = flight.fails(C.PREPARE, C.ARM, timeout_s=1.5)
    assert message == "arm not done within 1.5 s: vehicle 1: PHASE_CHANGED: arm -> ready (arm failed: no)"
    assert flight.vehicles.received.count((C.ARM, (1,))) >= 1


def test_a_take_off_that_ends_in_observe_ends_the_flight(flight: DirectedFlight) -> None:
    flight.vehicles.falls[2, C.TAKEOFF] = "takeoff -> observe (the autopilot disarmed)"
    message = flight.fails(C.PREPARE, C.ARM, C.TAKEOFF)
    assert message == "vehicle 2 gave up at takeoff: PHASE_CHANGED: takeoff -> observe (the autopilot disarmed)"


def test_the_flight_ends_with_a_landing_when_a_pilot_takes_over_in_formation(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.check = lambda: (  # type: ignore[method-assign]
        flight.vehicles.change(
            2,
            phase=P.OBSERVE,
            last_event=event_of("formation -> observe (mode POSCTL was set by someone else)"),
        )
        if flight.vehicles.statuses[2].phase is P.FORMATION
        else None
    )
    message = flight.fails(C.FORM, for_s=5.0)
    assert "vehicle 2" in message
    assert "mode POSCTL was set by someone else" in message
    assert flight.director.land_all() is None
    assert flight.vehicles.received[-2:] == [(C.LAND, (2,)), (C.LAND, (1,))]
    assert not any(s.autopilot.armed for s in flight.vehicles.statuses.values())


def test_one_that_no_agent_steers_lands_first_and_the_others_keep_off_meanwhile(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF, C.FORM)
    flight.vehicles.change(2, phase=P.HOLD)
    assert flight.director.land_all() is None
    assert flight.vehicles.received[-2:] == [(C.LAND, (2,)), (C.LAND, (1,))]


def test_the_others_land_beside_one_whose_touchdown_is_not_seen(
    flight: DirectedFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(director, "FIRST_WITHIN_S", 1.0)
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF, C.FORM)
    flight.vehicles.change(2, phase=P.HOLD)
    flight.vehicles.refuses[2, C.LAND] = ["no answer of the autopilot"] * 4
    assert flight.director.land_all() is None
    commanded = [ids for name, ids in flight.vehicles.received if name is C.LAND]
    assert commanded[0] == (2,) and commanded.count((1, 2)) == 1  # vehicle 1 accepts when it is commanded at last


@pytest.mark.parametrize("name", [C.LAND, C.RETURN])
def test_the_flight_ends_when_a_pilot_stops_a_landing(flight: DirectedFlight, name: CommandName) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.vehicles.falls[2, name] = f"{name} -> observe (mode POSCTL was set by someone else)"
    message = flight.fails(name, timeout_s=5.0)
    assert (
        message
        == f"vehicle 2 gave up at {name}: PHASE_CHANGED: {name} -> observe (mode POSCTL was set by someone else)"
    )


def test_a_return_ends_when_all_have_landed_and_has_a_timeout_of_300_s(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    home = TimelineStep(command=C.RETURN)
    assert (home.patience_s, TimelineStep(command=C.LAND).patience_s) == (300.0, 30.0)
    assert TimelineStep(command=C.RETURN, timeout_s=7.0).patience_s == 7.0
    flight.director.fly([home])
    assert not any(s.autopilot.armed for s in flight.vehicles.statuses.values())


def test_the_formation_is_closed_when_a_process_ends(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF, C.FORM)
    flight.checks = ["agent 2 was killed by SIGKILL: no output"]
    assert flight.fails(C.FORM) == "agent 2 was killed by SIGKILL: no output"
    assert flight.watch.formation is not None


def test_armed_vehicles_on_the_ground_are_disarmed_unless_silent(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM)
    flight.vehicles.mute = {2}
    time.sleep(1.1)
    assert flight.director.land_all() is None
    assert flight.vehicles.received[-1] == (C.DISARM, (1,))
    assert flight.vehicles.statuses[2].autopilot.armed


def test_the_landing_does_not_wait_for_a_vehicle_without_autopilot(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.lost = {2}
    flight.vehicles.refuses[2, C.LAND] = ["no autopilot"] * 1000
    assert flight.director.land_all() is None
    assert flight.vehicles.received[-1] == (C.LAND, (1,))


def test_a_step_for_one_vehicle_does_not_change_the_others(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form, leave = TimelineStep(command=C.FORM), TimelineStep(command=C.HOLD, vehicles=(2,), for_s=0.2)
    join = TimelineStep(command=C.FORM, vehicles=(2,), for_s=0.3)
    flight.director.fly([form, leave, join])
    assert flight.vehicles.received[-2:] == [(C.HOLD, (2,)), (C.FORM, (2,))]
    first, second = flight.watch.formations  # formation is counted while all vehicles are in it
    assert first.end_s < second.start_s
    assert second.end_s - second.start_s == pytest.approx(0.3, abs=0.1)


def test_the_flight_ends_when_another_vehicle_leaves_its_phase(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form, leave = TimelineStep(command=C.FORM), TimelineStep(command=C.HOLD, vehicles=(2,), for_s=5.0)

    def falls_out() -> None:
        if flight.vehicles.received[-1] == (C.HOLD, (2,)):
            flight.vehicles.change(1, phase=P.HOLD, last_event=event_of("formation -> release (no leader beacon)"))

    flight.check = falls_out  # type: ignore[method-assign]
    with pytest.raises(FlightFailure, match="vehicle 1 left phase formation"):
        flight.director.fly([form, leave])


def test_a_step_begins_at_its_time_or_at_once_when_that_has_passed(flight: DirectedFlight) -> None:
    steps = [TimelineStep(command=C.PREPARE, at_s=0.5), TimelineStep(command=C.ARM, at_s=0.5)]
    flight.director.fly(steps)
    prepared, armed = flight.watch.commands
    assert prepared.time_s == pytest.approx(0.5, abs=0.2)
    assert armed.time_s > prepared.time_s


def lead_step(*leaders: int, for_s: float = 0.2, timeout_s: float = 2.0) -> TimelineStep:
    return TimelineStep(command=C.LEAD, leaders=leaders, for_s=for_s, timeout_s=timeout_s)


def test_the_formation_continues_over_leadership_changes(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form = TimelineStep(command=C.FORM, for_s=0.2)
    flight.director.fly([form, lead_step(2), lead_step(1), TimelineStep(command=C.LAND)])
    formation = flight.watch.formation
    assert formation is not None
    assert formation.end_s - formation.start_s == pytest.approx(0.6, abs=0.15)
    assert formation.start_s - formation.reference_start_s == pytest.approx(DOING_S, abs=0.03)
    assert list(dict.fromkeys(flight.vehicles.leads)) == [Lead((2,), 1), Lead((1,), 2)]


def test_every_topology_change_is_recorded(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE)
    flight.director.fly([lead_step(2, for_s=0.0)])
    recorded = [(c.vehicle, c.role, c.epoch) for c in flight.watch.topology]
    assert recorded == [(1, "leader", 0), (2, "follower", 0), (1, "follower", 1), (2, "leader", 1)]


def test_the_next_epoch_is_newer_than_every_reported_epoch(flight: DirectedFlight) -> None:
    flight.vehicles.change(2, epoch=7)
    for report in flight.vehicles.drain():
        flight.watch.receive(report, flight.watch.began_s)
    flight.director.fly([lead_step(2)])
    assert set(flight.vehicles.leads) == {Lead((2,), 8)}


def test_a_refused_leader_change_is_repeated_in_its_epoch(flight: DirectedFlight) -> None:
    flight.vehicles.refuses[2, C.LEAD] = ["lead: not now"]
    flight.director.fly([lead_step(2)])
    assert flight.vehicles.received == [(C.LEAD, (2,)), (C.LEAD, (2,)), (C.LEAD, (1,))]
    assert flight.vehicles.leads == [Lead((2,), 1)] * 3
    flight.vehicles.refuses[1, C.LEAD] = ["lead: not now"] * 20
    with pytest.raises(FlightFailure) as caught:
        flight.director.fly([lead_step(1, timeout_s=0.7)])
    assert str(caught.value) == (
        "lead not done within 0.7 s: vehicle 1: WRONG_PHASE: lead: not now;"
        " vehicle 2: not commanded before the new leaders have accepted"
    )
    assert [flight.vehicles.statuses[i].leadership.role for i in (1, 2)] == [Role.FOLLOWER, Role.LEADER]


def test_the_flight_ends_when_a_vehicle_leaves_formation_after_a_leader_change(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form = TimelineStep(command=C.FORM, for_s=0.1)
    vehicles = flight.vehicles

    def falls_out() -> None:
        if vehicles.leads:
            vehicles.change(1, phase=P.HOLD, last_event=event_of("formation -> release (no leader beacon)"))

    flight.check = falls_out  # type: ignore[method-assign]
    with pytest.raises(FlightFailure, match="vehicle 1 left phase formation: PHASE_CHANGED: formation -> release"):
        flight.director.fly([form, lead_step(2, for_s=1.0)])


def test_events_are_recorded_once_and_by_vehicle(flight: DirectedFlight) -> None:
    for event in ("a", "a", "b"):
        flight.vehicles.change(1, last_event=event_of(event))
        for report in flight.vehicles.drain():
            flight.watch.receive(report, flight.watch.began_s + 1.0)
    assert [(e.time_s, e.vehicle, e.event) for e in flight.watch.events] == [(1.0, 1, "a"), (1.0, 1, "b")]


def test_progress_is_plain_lines_without_a_terminal(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE, C.ARM)
    text = flight.shown.getvalue()
    assert "\x1b" not in text
    assert "pair   step 1 of 2, prepare" in text
    assert text.splitlines()[-1].endswith("all arm")


def test_missing_data_have_no_age(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE)
    row = flight.watch.vehicles_at(time.monotonic())[0]
    assert row_of(dataclasses.replace(row, data_age_s=1e6, silent=False)).endswith("  -")
    assert row_of(dataclasses.replace(row, data_age_s=0.02, silent=False)).endswith("  20 ms old")


APART = {1: (1.0, 0.5, 0.0), 2: (1.0, 1.0, 0.0)}
POINT = TimelineStep(command=C.REFERENCE, reference=PointReference((1.0, 2.0, 3.0)), timeout_s=1.2)


def test_a_reference_change_is_sent_to_possible_leaders_with_the_next_number(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE)
    flight.vehicles.change(1, reference=HeldReference(3, 4), reference_s=40.2)
    flight.fly(C.ARM)
    flight.director.fly([POINT])
    assert flight.vehicles.received[-1] == (C.REFERENCE, (1,))
    assert flight.vehicles.references[-1] == ReferenceChange(
        5, {"kind": "point", "point_enu_m": (1.0, 2.0, 3.0)}, pytest.approx(41.2)
    )


def test_the_flight_ends_with_the_reason_when_a_reference_is_refused(flight: DirectedFlight) -> None:
    flight.fly(C.PREPARE)
    flight.vehicles.change(1, reference=HeldReference())
    flight.fly(C.ARM)
    flight.vehicles.refuses[1, C.REFERENCE] = ["reference: too far away"] * 9
    with pytest.raises(
        FlightFailure, match=r"reference not done within 1\.2 s: vehicle 1: WRONG_PHASE: reference: too far away"
    ):
        flight.director.fly([POINT])


def test_a_formation_is_complete_where_the_rounded_slots_of_the_reports_are_those_commanded(
    flight: DirectedFlight,
) -> None:
    flight.fly(C.PREPARE)
    slots_enu_m = {1: (2.0**0.5, 1.0 / 3.0, 0.0), 2: (-(2.0**0.5), 0.0, 0.0)}
    flight.director.fly(
        [TimelineStep(command=C.FORMATION, formation=FormationStep(slots_enu_m=slots_enu_m), timeout_s=1.2)]
    )
    assert flight.vehicles.received[-1] == (C.FORMATION, (1, 2))


def test_a_formation_that_is_still_on_its_way_is_not_complete(
    flight: DirectedFlight, monkeypatch: pytest.MonkeyPatch
) -> None:
    flight.fly(C.PREPARE)
    changed = flight.vehicles.change
    monkeypatch.setattr(
        flight.vehicles,
        "change",
        lambda i, slot: changed(i, slot=replace(slot, position_enu_m=(1.0, 0.5, 0.0), moves_for_s=1.0)),
    )
    step = TimelineStep(command=C.FORMATION, formation=FormationStep(slots_enu_m=APART), timeout_s=0.6)
    with pytest.raises(FlightFailure, match=r"vehicle 2: its slot is 0\.50 m from that of formation 1"):
        flight.director.fly([step])


@pytest.mark.parametrize(
    ("cancels", "refuses"), [({1, 2}, []), ({1}, ["begins at mission time 1.0 s, which is 3.0 s now"])]
)
def test_a_formation_that_did_not_begin_is_given_anew_with_another_begin(
    flight: DirectedFlight, cancels: set[int], refuses: list[str]
) -> None:
    flight.fly(*WHOLE[:4])
    flight.vehicles.cancels, flight.vehicles.refuses[2, C.FORMATION] = set(cancels), refuses
    given = len(flight.vehicles.received)
    step = TimelineStep(command=C.FORMATION, formation=FormationStep(slots_enu_m=APART), timeout_s=5.0)
    flight.director.fly([step])
    assert flight.vehicles.received[given:] == [(C.FORMATION, (1, 2))] * 2
    assert {status.formation.slot.formation for status in flight.vehicles.statuses.values()} == {1}
