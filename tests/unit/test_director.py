"""The director against vehicles that obey, refuse, fall back and fall silent, without any process."""

import dataclasses
import io
import time
from collections.abc import Iterable

import pytest
from msgspec.structs import replace

from companion.config.reference import PointReference
from companion.core.phase import RULES
from companion.types import (
    CommandName,
    CommandReply,
    Content,
    FlightPhase,
    FlownSlot,
    HeldReference,
    LandedState,
    Lead,
    ReferenceChange,
    Role,
    Status,
)
from companion.wire.ground import Percentiles, StatusReport, Timing
from sitl.director import Director, MachineClock
from sitl.orders import FlightFailure
from sitl.progress import Progress, vehicle_line
from sitl.timeline import TimelineStep
from sitl.watch import FlightWatch

C, P = CommandName, FlightPhase
TIMING = Timing(50.0, 100, 0, Percentiles(1, 2, 3), Percentiles(4, 5, 6), 5.0, 48.0)
DOING_S = 0.05  # how long a vehicle takes to do what it is told


def status(vehicle_id: int) -> Status:
    leads = vehicle_id == 1
    return Status(
        vehicle_id=vehicle_id,
        session=1,
        fleet="pair",
        formation_hash=1,
        law="weighted",
        phase=P.OBSERVE,
        mode_name="HOLD",
        armed=False,
        landed=LandedState.ON_GROUND,
        position_enu_m=(0.0, 0.0, 0.0),
        velocity_enu_m_s=(0.0, 0.0, 0.0),
        state_age_s=0.01,
        hover_thrust_norm=0.5,
        disturbance_enu_m_s2=(0.0, 0.0, 0.0),
        role=Role.LEADER if leads else Role.FOLLOWER,
        epoch=0,
        prc=vehicle_id,
        leader_word=None,
        leader_word_age_s=None,
        neighbours=(),
        slot=FlownSlot((0.0, 0.0, 0.0)),
        reference_enu_m=(0.0, 0.0, 0.0) if leads else None,
        flags=(),
        rejected={},
        last_event="",
    )


class Vehicles:
    """Stands in for a FleetSession with two vehicles behind it."""

    def __init__(self) -> None:
        self.statuses = {1: status(1), 2: status(2)}
        self.refuses: dict[tuple[int, CommandName], list[str]] = {}  # reasons, one for each time
        self.falls: dict[tuple[int, CommandName], str] = {}  # the procedure fails with this event
        self.mute: set[int] = set()
        self.heard: list[tuple[CommandName, tuple[int, ...]]] = []
        self.leads: list[Lead] = []
        self.references: list[ReferenceChange] = []
        self._due: dict[int, tuple[float, CommandName]] = {}

    def command(
        self, ids: Iterable[int], name: CommandName, timeout_s: float, content: Content | None = None
    ) -> dict[int, CommandReply | None]:
        assert timeout_s > 0
        assert (name is C.LEAD) is isinstance(content, Lead)
        asked = tuple(ids)
        self.heard.append((name, asked))
        if isinstance(content, ReferenceChange):
            self.references.append(content)
            return {i: self._change_reference(i, content) for i in asked}
        if isinstance(content, Lead):
            self.leads.append(content)
            return {i: None if i in self.mute else self._change_lead(i, content) for i in asked}
        return {i: None if i in self.mute else self._obey(i, name) for i in asked}

    def _change_lead(self, vehicle_id: int, lead: Lead) -> CommandReply:
        if reasons := self.refuses.get((vehicle_id, C.LEAD)):
            return CommandReply(vehicle_id, 1, False, reasons.pop(0))
        role = Role.LEADER if vehicle_id in lead.leaders else Role.FOLLOWER
        self.change(vehicle_id, role=role, epoch=lead.epoch)
        return CommandReply(vehicle_id, 1, True, "yes")

    def _change_reference(self, vehicle_id: int, change: ReferenceChange) -> CommandReply:
        if reasons := self.refuses.get((vehicle_id, C.REFERENCE)):
            return CommandReply(vehicle_id, 1, False, reasons.pop(0))
        self.change(vehicle_id, reference=HeldReference(change.number, change.number, change.begins_s))
        return CommandReply(vehicle_id, 1, True, "yes")

    def _obey(self, vehicle_id: int, name: CommandName) -> CommandReply:
        reasons = self.refuses.get((vehicle_id, name))
        if reasons:
            return CommandReply(vehicle_id, 1, False, reasons.pop(0))
        self.statuses[vehicle_id] = replace(self.statuses[vehicle_id], phase=RULES[name].via)
        self._due[vehicle_id] = (time.monotonic() + DOING_S * vehicle_id, name)
        return CommandReply(vehicle_id, 1, True, "yes")

    def drain(self) -> list[StatusReport]:
        for vehicle_id, (due_s, name) in list(self._due.items()):
            if time.monotonic() >= due_s:
                del self._due[vehicle_id]
                self._finish(vehicle_id, name)
        return [StatusReport(s, TIMING) for s in self.statuses.values() if s.vehicle_id not in self.mute]

    def _finish(self, vehicle_id: int, name: CommandName) -> None:
        before = self.statuses[vehicle_id]
        if event := self.falls.get((vehicle_id, name)):
            fallen_to = P.OBSERVE if "-> observe" in event else RULES[name].on_failure
            self.statuses[vehicle_id] = replace(before, phase=fallen_to, last_event=event)
            return
        up = name in (C.TAKEOFF, C.FORM, C.HOLD)
        self.statuses[vehicle_id] = replace(
            before,
            phase=RULES[name].to,
            armed=name not in (C.PREPARE, C.LAND, C.RETURN, C.DISARM),
            landed=LandedState.IN_AIR if up else LandedState.ON_GROUND,
        )

    def change(self, vehicle_id: int, **what: object) -> None:
        self.statuses[vehicle_id] = replace(self.statuses[vehicle_id], **what)  # type: ignore[arg-type]


class Flight:
    def __init__(self) -> None:
        self.vehicles = Vehicles()
        self.watch = FlightWatch([1, 2], [1], time.monotonic())
        self.shown = io.StringIO()
        self.checks: list[str] = []
        self.lost: set[int] = set()
        self.director = Director(
            self.vehicles,
            self.watch,
            Progress("pair", False, self.watch.began_s, self.shown),
            self._check,
            lambda: self.lost,
            MachineClock(),
        )

    def _check(self) -> None:
        if self.checks:
            raise FlightFailure(self.checks.pop())

    def fly(self, *commands: CommandName, for_s: float = 0.3, timeout_s: float = 2.0) -> None:
        steps = [
            TimelineStep(command=name, for_s=for_s if name is C.FORM else 0.0, timeout_s=timeout_s) for name in commands
        ]
        self.director.fly(steps)

    def fails(self, *commands: CommandName, for_s: float = 0.3, timeout_s: float = 2.0) -> str:
        with pytest.raises(FlightFailure) as caught:
            self.fly(*commands, for_s=for_s, timeout_s=timeout_s)
        assert "\n" not in str(caught.value)
        return str(caught.value)


WHOLE = (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM, C.LAND)


@pytest.fixture
def flight() -> Flight:
    return Flight()


def test_a_whole_timeline_is_flown_and_the_formation_timed(flight: Flight) -> None:
    flight.fly(*WHOLE)
    assert [name for name, _ in flight.vehicles.heard] == list(WHOLE)
    formation = flight.watch.formation
    assert formation is not None
    # The last vehicle enters 0.1 s after the command, the leader 0.05 s before it; the clock starts with the last.
    assert formation.end_s - formation.start_s == pytest.approx(0.3, abs=0.1)
    assert formation.start_s - formation.reference_start_s == pytest.approx(DOING_S, abs=0.03)
    assert flight.watch.timing == {1: TIMING, 2: TIMING}
    assert flight.director.land_all() is None
    assert flight.vehicles.heard[-1][0] is C.LAND  # nobody had to be told again


def test_a_refused_command_is_repeated_to_those_who_refused(flight: Flight) -> None:
    flight.vehicles.refuses[2, C.ARM] = ["arm: not ready", "arm: still not ready"]
    flight.fly(C.PREPARE, C.ARM, timeout_s=5.0)
    assert flight.vehicles.heard == [(C.PREPARE, (1, 2)), (C.ARM, (1, 2)), (C.ARM, (2,)), (C.ARM, (2,))]


def test_who_never_accepts_is_named_with_its_last_reason(flight: Flight) -> None:
    flight.vehicles.refuses[2, C.ARM] = ["first", *["arm: the autopilot's origin is unknown"] * 20]
    message = flight.fails(C.PREPARE, C.ARM, timeout_s=1.2)
    assert message == "arm not done within 1.2 s: vehicle 2: arm: the autopilot's origin is unknown"


def test_vehicles_with_one_reason_are_said_together(flight: Flight) -> None:
    flight.vehicles.mute = {1, 2}
    message = flight.fails(C.PREPARE, timeout_s=0.2)
    assert message == "prepare not done within 0.2 s: vehicles 1, 2: its agent does not answer"


def test_a_procedure_that_fails_on_the_ground_is_tried_again(flight: Flight) -> None:
    flight.vehicles.falls[1, C.ARM] = "arm -> ready (arm failed: no)"
    message = flight.fails(C.PREPARE, C.ARM, timeout_s=1.5)
    assert message == "arm not done within 1.5 s: vehicle 1: arm -> ready (arm failed: no)"
    assert flight.vehicles.heard.count((C.ARM, (1,))) >= 1


def test_a_take_off_that_ends_in_observe_ends_the_flight(flight: Flight) -> None:
    flight.vehicles.falls[2, C.TAKEOFF] = "takeoff -> observe (the autopilot disarmed)"
    message = flight.fails(C.PREPARE, C.ARM, C.TAKEOFF)
    assert message == "vehicle 2 gave up at takeoff: takeoff -> observe (the autopilot disarmed)"


def test_a_pilot_who_takes_over_in_formation_ends_the_flight_and_all_are_landed(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.director._check = lambda: (
        flight.vehicles.change(  # type: ignore[method-assign]
            2, phase=P.OBSERVE, last_event="formation -> observe (mode POSCTL was set by someone else)"
        )
        if flight.vehicles.statuses[2].phase is P.FORMATION
        else None
    )
    message = flight.fails(C.FORM, for_s=5.0)
    assert "vehicle 2" in message
    assert "mode POSCTL was set by someone else" in message
    assert flight.director.land_all() is None
    assert flight.vehicles.heard[-1] == (C.LAND, (1, 2))
    assert not any(s.armed for s in flight.vehicles.statuses.values())


@pytest.mark.parametrize("name", [C.LAND, C.RETURN])
def test_a_landing_that_a_pilot_stops_ends_the_flight(flight: Flight, name: CommandName) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.vehicles.falls[2, name] = f"{name} -> observe (mode POSCTL was set by someone else)"
    message = flight.fails(name, timeout_s=5.0)
    assert message == f"vehicle 2 gave up at {name}: {name} -> observe (mode POSCTL was set by someone else)"


def test_a_return_is_done_when_all_are_down_and_takes_as_long_as_it_may(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    home = TimelineStep(command=C.RETURN)
    assert (home.patience_s, TimelineStep(command=C.LAND).patience_s) == (300.0, 30.0)
    assert TimelineStep(command=C.RETURN, timeout_s=7.0).patience_s == 7.0
    flight.director.fly([home])
    assert not any(s.armed for s in flight.vehicles.statuses.values())


def test_what_ends_the_flight_from_outside_closes_the_formation(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF, C.FORM)
    flight.checks = ["agent 2 was killed by SIGKILL: it said nothing"]
    assert flight.fails(C.FORM) == "agent 2 was killed by SIGKILL: it said nothing"
    assert flight.watch.formation is not None


def test_armed_vehicles_on_the_ground_are_disarmed_and_the_silent_left_alone(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM)
    flight.vehicles.mute = {2}
    time.sleep(1.1)
    assert flight.director.land_all() is None
    assert flight.vehicles.heard[-1] == (C.DISARM, (1,))
    assert flight.vehicles.statuses[2].armed


def test_a_vehicle_without_its_autopilot_is_not_waited_for(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    flight.lost = {2}
    flight.vehicles.refuses[2, C.LAND] = ["no autopilot"] * 1000
    assert flight.director.land_all() is None
    assert flight.vehicles.heard[-1] == (C.LAND, (1,))


def test_a_step_for_one_vehicle_leaves_the_others_as_they_are(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form, leave = TimelineStep(command=C.FORM), TimelineStep(command=C.HOLD, vehicles=(2,), for_s=0.2)
    join = TimelineStep(command=C.FORM, vehicles=(2,), for_s=0.3)
    flight.director.fly([form, leave, join])
    assert flight.vehicles.heard[-2:] == [(C.HOLD, (2,)), (C.FORM, (2,))]
    first, second = flight.watch.formations  # it is one only where all fly in it
    assert first.end_s < second.start_s
    assert second.end_s - second.start_s == pytest.approx(0.3, abs=0.1)


def test_while_one_is_away_the_others_are_held_to_their_phase(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form, leave = TimelineStep(command=C.FORM), TimelineStep(command=C.HOLD, vehicles=(2,), for_s=5.0)

    def falls_out() -> None:
        if flight.vehicles.heard[-1] == (C.HOLD, (2,)):
            flight.vehicles.change(1, phase=P.HOLD, last_event="formation -> release (no leader's word)")

    flight.director._check = falls_out  # type: ignore[method-assign]
    with pytest.raises(FlightFailure, match="vehicle 1 left phase formation"):
        flight.director.fly([form, leave])


def test_a_step_waits_for_its_time_and_comes_at_once_where_that_is_over(flight: Flight) -> None:
    steps = [TimelineStep(command=C.PREPARE, at_s=0.5), TimelineStep(command=C.ARM, at_s=0.5)]
    flight.director.fly(steps)
    prepared, armed = flight.watch.commands
    assert prepared.time_s == pytest.approx(0.5, abs=0.2)
    assert armed.time_s > prepared.time_s


def lead_step(*leaders: int, for_s: float = 0.2, timeout_s: float = 2.0) -> TimelineStep:
    return TimelineStep(command=C.LEAD, leaders=leaders, for_s=for_s, timeout_s=timeout_s)


def test_the_formation_goes_on_over_changes_of_the_lead(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form = TimelineStep(command=C.FORM, for_s=0.2)
    flight.director.fly([form, lead_step(2), lead_step(1), TimelineStep(command=C.LAND)])
    formation = flight.watch.formation
    assert formation is not None
    assert formation.end_s - formation.start_s == pytest.approx(0.6, abs=0.15)
    assert formation.start_s - formation.reference_start_s == pytest.approx(DOING_S, abs=0.03)
    assert list(dict.fromkeys(flight.vehicles.leads)) == [Lead((2,), 1), Lead((1,), 2)]


def test_the_topology_is_kept_with_every_change(flight: Flight) -> None:
    flight.fly(C.PREPARE)
    flight.director.fly([lead_step(2, for_s=0.0)])
    told = [(c.vehicle, c.role, c.epoch) for c in flight.watch.topology]
    assert told == [(1, "leader", 0), (2, "follower", 0), (1, "follower", 1), (2, "leader", 1)]


def test_the_next_epoch_is_newer_than_any_that_a_vehicle_knows(flight: Flight) -> None:
    flight.vehicles.change(2, epoch=7)
    for report in flight.vehicles.drain():
        flight.watch.hear(report, flight.watch.began_s)
    flight.director.fly([lead_step(2)])
    assert set(flight.vehicles.leads) == {Lead((2,), 8)}


def test_a_refused_lead_is_repeated_in_its_epoch_and_who_never_takes_it_is_named(flight: Flight) -> None:
    flight.vehicles.refuses[2, C.LEAD] = ["lead: not now"]
    flight.director.fly([lead_step(2)])
    assert flight.vehicles.heard == [(C.LEAD, (2,)), (C.LEAD, (2,)), (C.LEAD, (1,))]
    assert flight.vehicles.leads == [Lead((2,), 1)] * 3
    flight.vehicles.refuses[1, C.LEAD] = ["lead: not now"] * 20
    with pytest.raises(FlightFailure) as caught:
        flight.director.fly([lead_step(1, timeout_s=0.7)])
    assert str(caught.value) == (
        "lead not done within 0.7 s: vehicle 1: lead: not now;"
        " vehicle 2: not asked before who is to lead takes the lead"
    )
    assert [flight.vehicles.statuses[i].role for i in (1, 2)] == [Role.FOLLOWER, Role.LEADER]


def test_a_vehicle_that_leaves_formation_after_a_change_of_the_lead_ends_the_flight(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM, C.TAKEOFF)
    form = TimelineStep(command=C.FORM, for_s=0.1)
    vehicles = flight.vehicles

    def falls_out() -> None:
        if vehicles.leads:
            vehicles.change(1, phase=P.HOLD, last_event="formation -> release (no leader's word)")

    flight.director._check = falls_out  # type: ignore[method-assign]
    with pytest.raises(FlightFailure, match="vehicle 1 left phase formation: formation -> release"):
        flight.director.fly([form, lead_step(2, for_s=1.0)])


def test_events_are_recorded_once_and_by_vehicle(flight: Flight) -> None:
    for event in ("a", "a", "b"):
        flight.vehicles.change(1, last_event=event)
        for report in flight.vehicles.drain():
            flight.watch.hear(report, flight.watch.began_s + 1.0)
    assert [(e.time_s, e.vehicle, e.event) for e in flight.watch.events] == [(1.0, 1, "a"), (1.0, 1, "b")]


def test_progress_off_a_terminal_is_plain_lines(flight: Flight) -> None:
    flight.fly(C.PREPARE, C.ARM)
    text = flight.shown.getvalue()
    assert "\x1b" not in text
    assert "pair   step 1 of 2, prepare" in text
    assert "UAV 1   leader    arm" in text
    assert "PrC 2" in text


def test_data_that_never_came_has_no_age(flight: Flight) -> None:
    flight.fly(C.PREPARE)
    row = flight.watch.rows(time.monotonic())[0]
    assert "data   - " in vehicle_line(dataclasses.replace(row, data_age_s=1e6, silent=False)) + " "
    assert "data  20 ms old" in vehicle_line(dataclasses.replace(row, data_age_s=0.02, silent=False))


POINT = TimelineStep(command=C.REFERENCE, reference=PointReference((1.0, 2.0, 3.0)), timeout_s=1.2)


def test_another_reference_goes_to_those_that_may_lead_in_the_next_number_and_soon(flight: Flight) -> None:
    flight.fly(C.PREPARE)
    flight.vehicles.change(1, reference=HeldReference(3, 4), reference_s=40.2)
    flight.fly(C.ARM)
    flight.director.fly([POINT])
    assert flight.vehicles.heard[-1] == (C.REFERENCE, (1,))
    assert flight.vehicles.references[-1] == ReferenceChange(
        5, {"kind": "point", "point_enu_m": (1.0, 2.0, 3.0)}, pytest.approx(41.2)
    )


def test_a_reference_that_is_refused_ends_the_flight_with_the_reason(flight: Flight) -> None:
    flight.fly(C.PREPARE)
    flight.vehicles.change(1, reference=HeldReference())
    flight.fly(C.ARM)
    flight.vehicles.refuses[1, C.REFERENCE] = ["reference: too far away"] * 9
    with pytest.raises(FlightFailure, match=r"reference not done within 1\.2 s: vehicle 1: reference: too far away"):
        flight.director.fly([POINT])
