"""Reference changes in flight: blends without a step, also during leader changes, and a followed target."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from itertools import pairwise
from math import cos, dist, hypot, sin

import pytest

from common import ROOT, outcome
from companion.ground.changes import reference_change
from companion.types.commands import CommandName, Content, Lead
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code
from companion.types.status import Status
from companion.types.values import Vector3
from lockstep_fleet import JUMP_M, Decisions, Recorder, agent_of, director_of
from sitl.flight.flights import reference_flown
from sitl.flight.lockstep import Lockstep
from sitl.flight.scenario import load_scenario
from sitl.report.metrics import formation_figures, smallest_distance_m

RING = ROOT / "config" / "scenarios" / "ring_figure_8.yaml"
CIRCLE = "{kind: circle, centre_enu_m: [0, 0, 2], radius_m: 4, period_s: 20}"
WAY = "{kind: waypoints, points_enu_m: [[0, 5, 2], [6, 5, 3], [0, -5, 2]], wait_s: 2}"
UP = "{command: prepare}, {command: arm}, {command: takeoff, for_s: 3}, {command: form, for_s: 8}"
TIMELINE = (
    f"timeline=[{UP}, {{command: reference, reference: {CIRCLE}, for_s: 15}},"
    f" {{command: reference, reference: {WAY}}}, {{command: lead, leaders: [2], for_s: 20}}, {{command: land}}]"
)


class Flight:
    """The ring in virtual time, with all decisions."""

    def __init__(self, *overrides: str) -> None:
        self.scenario = load_scenario(RING, overrides)
        self.lockstep, self.watch = Lockstep(self.scenario), Recorder(self.scenario)
        self.decisions = Decisions(self.lockstep)
        self.director = director_of(self.lockstep, self.watch)

    def led(self, from_s: float = 0.0) -> Iterator[tuple[float, Status]]:
        """Reports of leaders in formation."""
        for at_s, status in self.watch.reports:
            beacon = status.leadership.leader_beacon
            if status.formation.reference_enu_m and beacon and beacon.reference_s > 0.0 and at_s >= from_s:
                yield at_s, status

    def command(self, name: CommandName, *ids: int, content: Content | None = None) -> None:
        answers = self.lockstep.ask(ids, name, 1.0, content)
        assert all(answer is not None and answer.reply.accepted for answer in answers.values()), answers

    def listen(self) -> dict[int, Status]:
        for report in self.lockstep.drain():
            self.watch.receive(report, self.lockstep.now_s())
        statuses = {i: self.watch.status(i) for i in self.watch.vehicle_ids}
        return {i: status for i, status in statuses.items() if status}


@cache
def circle_then_way() -> tuple[Flight, list[str]]:
    flight = Flight(TIMELINE, "fleet.law.name=cooperative")
    return flight, flight.director.fly_and_land(flight.scenario.timeline)


def begun(flight: Flight, number: int) -> float:
    return next(
        at_s for at_s, s in flight.watch.reports if s.formation.reference and s.formation.reference.flown == number
    )


def test_leaders_describe_the_reference_that_they_fly() -> None:
    flight, _ = circle_then_way()
    described = [(at_s, s) for at_s, s in flight.watch.reports if s.formation.described]
    assert all(status.leadership.role is Role.LEADER for _, status in described)
    kinds = {(s.formation.reference.flown, s.formation.described["kind"]) for _, s in described}  # type: ignore[union-attr,index]
    assert kinds == {(0, "figure_8"), (1, "circle"), (2, "waypoints")}
    assert {s.agent.vehicle_id for _, s in described} == {1, 2}
    led_s = [at_s for at_s, status in described if status.agent.vehicle_id == 1]
    assert max(later - earlier for earlier, later in pairwise(led_s)) <= 2.1


def test_a_circle_and_waypoints_are_flown_with_a_leader_change_in_the_blend() -> None:
    flight, failures = circle_then_way()
    assert failures == []
    events = [(event.vehicle, event.event) for event in flight.watch.events if "hand-over of" in event.event]
    assert {(i, event[:16]) for i, event in events} == {
        (i, f"reference {n} -> {n + 1}") for i in (1, 2) for n in (0, 1)
    }
    assert len({event for _, event in events}) == 2  # both have the same, to the tenth of a second
    lasts_s = float(events[-1][1].rpartition(" s)")[0].rpartition(" ")[2])
    led_s = next(at_s for at_s, s in flight.led() if s.agent.vehicle_id == 2)
    assert begun(flight, 2) < led_s < begun(flight, 2) + lasts_s
    assert not any(any(status.rejected) for _, status in flight.watch.reports)


def test_slots_and_references_do_not_jump_and_vehicles_keep_their_distance() -> None:
    flight, _ = circle_then_way()
    formation = flight.watch.formation
    assert formation is not None
    assert flight.decisions.jump_m() < JUMP_M
    tracks = {s.vehicle_id: s.track() for s in flight.lockstep.stand_ins}
    smallest_m = smallest_distance_m(tracks)
    assert smallest_m is not None
    assert smallest_m > 1.4


def test_the_reference_continues_without_a_jump_within_its_limits() -> None:
    flight, _ = circle_then_way()
    for (a_s, a), (b_s, b) in pairwise(flight.led()):
        assert a.formation.reference_enu_m is not None
        assert b.formation.reference_enu_m is not None
        assert dist(a.formation.reference_enu_m, b.formation.reference_enu_m) < 4.0 * (b_s - a_s) + 0.05
    last = list(flight.led())[-1][1]
    assert last.agent.vehicle_id == 2
    assert last.formation.reference_enu_m == pytest.approx((0.0, -5.0, 2.0))


def test_figures_use_the_flown_reference() -> None:
    flight, _ = circle_then_way()
    formation = flight.watch.formation
    assert formation is not None
    tracks = {s.vehicle_id: s.track() for s in flight.lockstep.stand_ins}
    reference = reference_flown(flight.scenario, flight.watch)
    figures = formation_figures(tracks, flight.watch.slots(), reference, formation)
    assert figures.final_error_m < 0.1


def test_a_reference_change_needs_all_vehicles_that_may_lead() -> None:
    flight = Flight("fleet.law.name=cooperative")
    flight.director.fly(flight.scenario.timeline[:3])
    flight.command(CommandName.FORM, 1, 2, 3, 4)
    flight.lockstep.sleep(3.0)
    point = {"kind": "point", "point_enu_m": [1.0, 1.0, 2.0]}
    change = reference_change(point, list(flight.listen().values()))
    answer = flight.lockstep.ask([3], CommandName.REFERENCE, 1.0, change)[3]
    assert answer is not None
    assert outcome(answer.reply) == (False, Code.REFERENCE_NOT_ALLOWED)
    flight.command(CommandName.REFERENCE, 1, content=change)
    flight.lockstep.sleep(2.0)
    statuses = flight.listen()
    assert statuses[1].last_event.code is Code.REFERENCE_CANCELLED
    assert statuses[1].formation.reference == statuses[2].formation.reference


def test_the_reference_time_stops_in_hold_and_a_change_begins_afterwards() -> None:
    flight = Flight("fleet.law.name=cooperative")
    flight.director.fly(flight.scenario.timeline[:3])
    flight.command(CommandName.FORM, 1, 2, 3, 4)
    flight.lockstep.sleep(8.0)
    flight.command(CommandName.HOLD, 1, 2, 3, 4)
    flight.lockstep.sleep(3.0)
    point = {"kind": "point", "point_enu_m": [1.0, 1.0, 2.0]}
    change = reference_change(point, list(flight.listen().values()))
    flight.command(CommandName.REFERENCE, 1, 2, content=change)
    flight.lockstep.sleep(3.0)
    assert {i: s.formation.reference.flown for i, s in flight.listen().items() if s.formation.reference} == {1: 0, 2: 0}
    flight.command(CommandName.FORM, 1, 2, 3, 4)
    flight.lockstep.sleep(8.0)
    statuses = flight.listen()
    assert {i: s.formation.reference.flown for i, s in statuses.items() if s.formation.reference} == {1: 1, 2: 1}
    assert statuses[1].formation.reference_enu_m == pytest.approx((1.0, 1.0, 2.0))


def test_an_agent_restarted_in_flight_does_not_become_leader_without_the_reference() -> None:
    flight = Flight("fleet.law.name=cooperative")
    flight.director.fly(flight.scenario.timeline[:3])
    flight.command(CommandName.FORM, 1, 2, 3, 4)
    flight.lockstep.sleep(3.0)
    point = {"kind": "point", "point_enu_m": [1.0, 1.0, 2.0]}
    change = reference_change(point, list(flight.listen().values()))
    flight.command(CommandName.REFERENCE, 1, 2, content=change)
    flight.lockstep.sleep(2.0)
    flight.lockstep.vehicles[2].agent = agent_of(flight.scenario, 2, session=2)
    flight.lockstep.sleep(2.0)
    for name, phase in ((CommandName.HOLD, FlightPhase.HOLD), (CommandName.FORM, FlightPhase.FORMATION)):
        flight.command(name, 2)
        flight.lockstep.sleep(2.0)
        assert flight.listen()[2].phase is phase
    answer = flight.lockstep.ask([2], CommandName.LEAD, 1.0, Lead((2,), 1))[2]
    assert answer is not None
    assert not answer.reply.accepted
    assert answer.reply.code is Code.REFERENCE_DIFFERS
    answer = flight.lockstep.ask([2], CommandName.REFERENCE, 1.0, change)[2]
    assert answer is not None
    assert outcome(answer.reply) == (True, Code.REFERENCE_ACCEPTED)
    flight.command(CommandName.LEAD, 1, 2, 3, 4, content=Lead((2,), 1))
    flight.lockstep.sleep(8.0)
    status = flight.listen()[2]
    assert status.formation.reference_enu_m == pytest.approx((1.0, 1.0, 2.0))


def follow(flight: Flight, seconds: float, path: Callable[[float], tuple[Vector3, Vector3]]) -> None:
    """A moving target that reports its position at 10 Hz."""
    began_s = flight.lockstep.now_s()
    for _ in range(round(seconds * 10.0)):
        position, velocity = path(flight.lockstep.now_s() - began_s)
        flight.lockstep.publish_target("main", velocity, position)
        flight.lockstep.sleep(0.1)
        flight.listen()


def test_a_target_is_followed_over_a_leader_change_and_its_loss_ends_at_rest() -> None:
    flight = Flight("fleet.law.name=cooperative")
    flight.director.fly(flight.scenario.timeline[:3])
    flight.command(CommandName.FORM, 1, 2, 3, 4)
    flight.lockstep.sleep(8.0)
    described = {"kind": "target", "start_enu_m": [0.0, 0.0, 2.0], "max_speed_m_s": 2.0}
    change = reference_change(described, list(flight.listen().values()))
    flight.command(CommandName.REFERENCE, 1, 2, content=change)

    def walk(t: float) -> tuple[Vector3, Vector3]:
        return (6.0 + t, 4.0 * sin(0.2 * t), 0.0), (1.0, 0.8 * cos(0.2 * t), 0.0)

    began_s = flight.lockstep.now_s()
    follow(flight, 15.0, walk)
    flight.lockstep.ask([1, 2, 3, 4], CommandName.LEAD, 1.0, Lead((2,), 1))
    follow(flight, 10.0, lambda t: walk(t + 15.0))
    for at_s, status in flight.led(began_s + 14.0):
        assert status.formation.reference_enu_m is not None
        assert dist(status.formation.reference_enu_m[:2], walk(at_s - began_s)[0][:2]) < 0.3
        assert status.formation.reference_enu_m[2] == 2.0
        assert status.formation.target_age_s is not None
        assert status.formation.target_age_s < 0.2
    assert flight.decisions.jump_m() < JUMP_M
    silent_s = flight.lockstep.now_s()
    for _ in range(60):
        flight.lockstep.sleep(0.1)
        statuses = flight.listen()
    assert any("target main is silent for 1 s" in event.event for event in flight.watch.events)
    assert statuses[2].formation.target_age_s is not None
    assert statuses[2].formation.target_age_s > 5.0
    at_rest = [s.formation.reference_enu_m for at_s, s in flight.led(silent_s + 4.0)]
    assert max(dist(a, b) for a, b in pairwise(at_rest) if a and b) < 1e-3
    assert max(hypot(*s.motion.velocity_enu_m_s) for s in statuses.values()) < 0.3
