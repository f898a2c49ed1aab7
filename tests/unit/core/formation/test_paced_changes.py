"""Commands and changes of leaders whose check is expensive: a bounded part of it in each tick, and cheap refusals first."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from typing import Any

import pytest

from companion.analysis.compression import COST_PER_STEP, Chain
from companion.config.fleet import FleetConfig, FormationMember, RangeNeighbours
from companion.config.law import LawSection
from companion.config.reference import CircleReference, Figure8Reference
from companion.core.formation.changes import HEARD_PERIOD_S, QUEUED, Changes
from companion.core.formation.slots import SlotPlan
from companion.core.paced import PENDING, RESULTS_KEPT, STEPS_PER_TICK, PacedChecks
from companion.types.commands import Command, CommandName, CommandReply, ReferenceChange
from companion.types.flight import Role
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Code, Judged
from companion.types.steps import Steps
from one_agent import AgentFlight

C = CommandName
VEHICLES = 12
TWELVE = FleetConfig(
    name="twelve",
    origin="indoor",
    vehicles=tuple(
        FormationMember(i, Role.LEADER if i == 1 else Role.FOLLOWER, (-1.5 * (i - 1), 0.0, 0.0), may_lead=i in (2, 3))
        for i in range(1, VEHICLES + 1)
    ),
    neighbours=RangeNeighbours(range_m=50.0),
    law=LawSection(name="weighted"),
    separation_m=1.0,
    successors=(2, 3),
)
LAP = Figure8Reference(centre_enu_m=(5.0, 0.0, 3.0), width_m=4.0, height_m=2.0, period_s=200.0)
ROUND = CircleReference(centre_enu_m=(5.0, 0.0, 3.0), radius_m=1.0, period_s=200.0)


def count(steps: int, result: str = "done") -> Steps[str]:
    for _ in range(steps - 1):
        yield
    return result


def waypoints(points: int, speed_m_s: float = 0.05) -> dict[str, object]:
    positions = [[3.0 + i * i * 7 % 61 / 20.0, i * 13 % 41 / 20.0 - 1.0, 3.0] for i in range(points)]
    return {
        "kind": "waypoints",
        "points_enu_m": positions,
        "max_speed_m_s": speed_m_s,
        "max_acceleration_m_s2": speed_m_s,
    }


def on_ground(reference: Figure8Reference | CircleReference = LAP) -> AgentFlight:
    flight = AgentFlight(fleet=TWELVE, reference=reference)
    flight.peer_reference_s = 30.0
    for _ in range(5):
        flight.tick()
    return flight


def changes_of(flight: AgentFlight) -> Changes:
    return flight.agent.guidance.changes


def reference_of(flight: AgentFlight, number: int, described: dict[str, object], ahead_s: float = 3.0) -> Command:
    change = ReferenceChange(number, described, flight.peer_reference_s + ahead_s)  # type: ignore[arg-type]
    return flight.command(C.REFERENCE, content=change)


def wider(number: int, begins_s: float, by: float = 1.05) -> FormationChange:
    slots = tuple((member.id, (by * member.slot_enu_m[0], 0.0, 0.0)) for member in TWELVE.vehicles)
    return FormationChange(number, slots, begins_s, 30.0)


def until_answered(
    flight: AgentFlight, given: Iterable[Command], most: int = 200
) -> tuple[list[CommandReply], list[int]]:
    """The replies, and the steps of each tick."""
    checks, replies, steps, commands = changes_of(flight).checks, [], [], tuple(given)
    awaited = len(commands)
    for _ in range(most):
        before = checks.steps
        replies += flight.tick(given=commands).replies
        steps.append(checks.steps - before)
        commands = ()
        if len(replies) == awaited:
            return replies, steps
    raise AssertionError(f"{len(replies)} of {awaited} answered")


# ---------------------------------------------------------------- paced checks


def test_a_check_is_done_in_as_many_ticks_as_it_needs_and_its_result_is_kept() -> None:
    checks = PacedChecks(4)
    results = []
    for _ in range(4):
        checks.begin_tick()
        results.append(checks.ask("key", lambda: count(13)))
    assert results == [PENDING] * 3 + ["done"]
    assert checks.steps == 13
    assert checks.ask("key", lambda: count(99)) == "done"
    assert checks.steps == 13
    for other in range(RESULTS_KEPT):
        checks.begin_tick()
        assert checks.ask(other, lambda: count(1)) == "done"
    checks.begin_tick()
    assert checks.ask("key", lambda: count(99)) is PENDING


def test_the_first_caller_of_a_tick_goes_before_a_check_that_began_earlier() -> None:
    checks = PacedChecks(4)
    assert checks.ask("leader", lambda: count(9)) is PENDING
    checks.begin_tick()
    assert checks.ask("command", lambda: count(6)) is PENDING
    assert checks.ask("leader", lambda: count(9)) is PENDING
    checks.begin_tick()
    assert checks.ask("command", lambda: count(6)) == "done"
    assert checks.steps == 4 + 6


def test_a_check_that_is_not_asked_for_any_more_is_dropped() -> None:
    checks = PacedChecks(4)
    checks.ask("key", lambda: count(9))
    checks.begin_tick()
    checks.begin_tick()
    assert checks.ask("key", lambda: count(3)) == "done"


# ---------------------------------------------------------------- commands


@pytest.mark.parametrize("speed_m_s", [0.05, 3.0], ids=["accepted", "refused"])
def test_two_hundred_waypoints_are_checked_over_several_ticks(
    monkeypatch: pytest.MonkeyPatch, speed_m_s: float
) -> None:
    solved: list[int] = []
    solve = Chain.solve

    def counted(chain: Chain, rate_rad_s: float) -> dict[int, complex]:
        solved.append(checks.steps)
        return solve(chain, rate_rad_s)

    monkeypatch.setattr(Chain, "solve", counted)
    flight = on_ground()
    checks = changes_of(flight).checks
    solved.clear()
    (reply,), steps = until_answered(flight, [reference_of(flight, 1, waypoints(200, speed_m_s))])
    assert reply.accepted == (speed_m_s < 1.0), reply.reason
    assert 1 < len(steps) < (50 if reply.accepted else 200)  # it begins a second after the command
    assert max(steps) <= STEPS_PER_TICK
    assert max(Counter(solved).values()) <= COST_PER_STEP * 4 // VEHICLES**3 + 1


def test_a_reply_that_comes_later_comes_once_and_again_when_the_command_is_sent_again() -> None:
    flight = on_ground()
    given = reference_of(flight, 1, waypoints(200))
    assert flight.tick(given=(given,)).replies == ()
    assert flight.tick(given=(given,)).replies == ()  # sent again meanwhile
    (reply,), _ = until_answered(flight, [given])
    assert (reply.number, reply.code) == (given.number, Code.REFERENCE_ACCEPTED)
    assert flight.tick().replies == ()
    assert flight.tick(given=(given,)).replies == (reply,)


def test_of_many_changes_in_one_tick_one_is_judged_in_a_tick_and_most_are_refused() -> None:
    flight = on_ground()
    given = [reference_of(flight, number, waypoints(60 + number)) for number in range(1, 33)]
    checks = changes_of(flight).checks
    first = flight.tick(given=tuple(given)).replies
    assert [reply.code for reply in first] == [Code.CHANGE_IN_PROGRESS] * (len(given) - QUEUED)
    assert checks.steps <= STEPS_PER_TICK
    numbers = []
    for _ in range(100):
        before = checks.steps
        numbers += [reply.number for reply in flight.tick().replies]
        assert checks.steps - before <= STEPS_PER_TICK
    assert numbers == [command.number for command in given[:QUEUED]]


def test_a_refusal_that_needs_no_check_comes_at_once_and_without_one() -> None:
    flight = on_ground()
    late = reference_of(flight, 1, waypoints(200), ahead_s=200.0)
    far = reference_of(flight, 5000, waypoints(200))
    close = flight.command(C.FORMATION, content=wider(1, flight.peer_reference_s + 3.0, by=0.2))
    for given, code in ((late, Code.CHANGE_NOT_IN_TIME), (far, Code.CHANGE_TOO_NEW), (close, Code.SLOT_TOO_CLOSE)):
        assert [reply.code for reply in flight.tick(given=(given,)).replies] == [code]
    assert changes_of(flight).checks.steps == 0


def test_an_abort_is_answered_at_once_while_a_change_is_checked() -> None:
    flight = on_ground()
    flight.tick(given=(reference_of(flight, 1, waypoints(200)),))
    (reply,) = flight.tick(C.ABORT).replies
    assert (reply.accepted, reply.code) == (True, Code.ALREADY_DONE)


# ---------------------------------------------------------------- changes of leaders


def test_a_leader_with_another_change_in_every_packet_is_judged_a_few_times_a_second(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    flight = on_ground(ROUND)
    checks, judged = changes_of(flight).checks, []
    judge_on_ground = SlotPlan.judge_on_ground

    def counted(slots: SlotPlan, change: FormationChange, *rest: Any) -> Judged:
        judged.append(change.number)
        return judge_on_ground(slots, change, *rest)

    monkeypatch.setattr(SlotPlan, "judge_on_ground", counted)
    ticks = 100
    for number in range(1, ticks + 1):
        change = wider(number, flight.peer_reference_s + 3.0, by=1.0 + 0.001 * number)
        slot = FlownSlot((0.0, 0.0, 0.0), formation=number, waiting=number)
        flight.peer_changes = {"change": change, "slot": slot}
        before = checks.steps
        flight.tick()
        assert checks.steps - before <= STEPS_PER_TICK
    assert 0 < len(judged) <= 0.02 * ticks / HEARD_PERIOD_S + 1
