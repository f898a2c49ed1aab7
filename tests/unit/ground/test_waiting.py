"""When an action is finished, failed or timed out, by the reports of the vehicles."""

from collections.abc import Callable

import pytest

from common import with_fields
from companion.ground.answers import AnswerKind, Outcome
from companion.ground.commands import wait_for
from companion.ground.goals import NOT_HELD_S, Goal, end_of, goal_of, progress_text
from companion.types.autopilot import LandedState
from companion.types.commands import CommandName, Lead, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, HeldReference
from companion.types.notices import Code, Notice
from companion.types.status import Status
from companion.types.values import ZERO3
from ground_fleet import directed_status

P, C = FlightPhase, CommandName


def report(phase: FlightPhase, armed: bool = True, **more: object) -> Status:
    return with_fields(directed_status(1), phase=phase, armed=armed, command_number=7, **more)


def code_of(name: CommandName, reported: Status) -> Code | None:
    goal = goal_of(name, None, running=False)
    assert goal
    end = end_of(goal, reported, 1.0)
    return end.notice.code if end else None


@pytest.mark.parametrize(
    ("name", "reported", "code"),
    [
        (C.ARM, report(P.ARM, armed=False), None),
        (C.ARM, report(P.ARMED), Code.ACTION_FINISHED),
        (C.ARM, report(P.READY, armed=False), Code.ACTION_FAILED),
        (C.TAKEOFF, report(P.TAKEOFF), None),
        (C.TAKEOFF, report(P.HOLD), Code.ACTION_FINISHED),
        (C.TAKEOFF, report(P.OBSERVE), Code.ACTION_FAILED),
        (C.FORM, report(P.ENGAGE), None),
        (C.FORM, report(P.FORMATION, slot=FlownSlot(ZERO3, moves_for_s=1.0)), None),
        (C.FORM, report(P.FORMATION, slot=FlownSlot(ZERO3)), Code.ACTION_FINISHED),
        (C.FORM, report(P.HOLD), Code.ACTION_FAILED),
        (C.HOLD, report(P.RELEASE), None),
        (C.HOLD, report(P.HOLD), Code.ACTION_FINISHED),
        (C.LAND, report(P.LAND), None),
        (C.LAND, report(P.OBSERVE, armed=False), Code.ACTION_FINISHED),
        (C.LAND, report(P.OBSERVE, armed=False, landed=LandedState.IN_AIR), Code.ACTION_FAILED),
        (C.LAND, report(P.OBSERVE), Code.ACTION_FAILED),  # a pilot took over
        (C.RETURN, report(P.RELEASE), None),
        (C.RETURN, report(P.RETURN), None),
        (C.RETURN, report(P.OBSERVE, armed=False), Code.ACTION_FINISHED),
        (C.DISARM, report(P.LAND), None),
        (C.DISARM, report(P.OBSERVE, armed=False), Code.ACTION_FINISHED),
        (C.ABORT, report(P.LAND), None),
        (C.ABORT, report(P.HOLD), Code.ACTION_FINISHED),
        (C.ABORT, report(P.OBSERVE), Code.ACTION_FINISHED),  # left to its pilot
    ],
)
def test_the_phase_decides_whether_an_action_is_finished(
    name: CommandName, reported: Status, code: Code | None
) -> None:
    assert code_of(name, reported) == code


def test_taking_command_is_finished_with_its_reply() -> None:
    assert goal_of(C.TAKE, None, running=True) is None


def test_every_other_command_has_a_goal() -> None:
    contents = {
        C.LEAD: Lead((1,), 3),
        C.FORMATION: FormationChange(3, (), 0.0, 1.0),
        C.REFERENCE: ReferenceChange(3, {}, 0.0),
    }
    for name in set(C) - {C.TAKE}:
        assert goal_of(name, contents.get(name), running=True), name


SLOT = FormationChange(3, ((1, (-2.0, 0.0, 0.0)), (2, ZERO3)), 0.0, 1.0)


@pytest.mark.parametrize(
    ("content", "reported", "running", "finished"),
    [
        (Lead((1,), 3), {"epoch": 2, "role": Role.LEADER}, True, False),
        (Lead((1,), 3), {"epoch": 3, "role": Role.FOLLOWER}, True, False),
        (Lead((1,), 3), {"epoch": 3, "role": Role.LEADER}, True, True),
        (Lead((2,), 3), {"epoch": 3, "role": Role.FOLLOWER}, True, True),
        (Lead((2,), 3), {"epoch": 4, "role": Role.LEADER}, True, True),  # a later command replaced it
        (FormationChange(3, (), 0.0, 1.0), {"slot": FlownSlot(ZERO3, formation=2, waiting=3)}, True, False),
        (
            FormationChange(3, (), 0.0, 1.0),
            {"slot": FlownSlot(ZERO3, formation=3, waiting=3, moves_for_s=1.0)},
            True,
            False,
        ),
        (FormationChange(3, (), 0.0, 1.0), {"slot": FlownSlot(ZERO3, formation=3, waiting=3)}, True, True),
        (SLOT, {"slot": FlownSlot((-1.0, 0.0, 0.0), formation=3, waiting=3)}, True, False),  # begins in this tick
        (SLOT, {"slot": FlownSlot((-2.0005, 0.0, 0.0), formation=3, waiting=3, moves_for_s=0.1)}, True, True),
        (SLOT, {"slot": FlownSlot((-1.0, 0.0, 0.0), formation=4, waiting=4)}, True, True),  # a later one replaced it
        (ReferenceChange(3, {}, 0.0), {"reference": HeldReference(2, 3)}, True, False),
        (ReferenceChange(3, {}, 0.0), {"reference": HeldReference(2, 3)}, False, True),
        (ReferenceChange(3, {}, 0.0), {"reference": HeldReference(3, 3)}, True, True),
        (ReferenceChange(3, {}, 0.0), {"reference": None}, True, False),
    ],
)
def test_a_change_is_finished_when_it_is_reported(
    content: Lead | FormationChange | ReferenceChange, reported: dict[str, object], running: bool, finished: bool
) -> None:
    goal = goal_of(C.LEAD, content, running)
    assert goal
    assert (end_of(goal, report(P.FORMATION, **reported), 1.0) is not None) is finished


class Reported:
    """Reports that come one after the other, one set for each look."""

    def __init__(self, *sets: dict[int, Status]) -> None:
        self._sets = list(sets)

    def newest(self) -> dict[int, Status]:
        return self._sets.pop(0) if len(self._sets) > 1 else self._sets[0]


ACCEPTED = Outcome(AnswerKind.ACCEPTED, Notice(Code.PHASE_CHANGED, "arm begins"), 0.01, number=7)
REFUSED = Outcome(AnswerKind.REFUSED, Notice(Code.WRONG_PHASE, "no"), 0.01, number=7)
ARM = goal_of(C.ARM, None, running=False)


def waited(
    reports: Reported, outcomes: dict[int, Outcome], timeout_s: float = 30.0
) -> tuple[dict[int, Outcome], list[str]]:
    shown: list[str] = []
    assert ARM
    show: Callable[[str], None] = shown.append
    return wait_for(ARM, outcomes, reports.newest, timeout_s, show), shown


def test_the_wait_ends_when_all_have_finished_and_shows_progress() -> None:
    armed, arming = report(P.ARMED), report(P.ARM, armed=False)
    outcomes, shown = waited(
        Reported({1: arming, 2: arming}, {1: armed, 2: arming}, {2: armed}), {1: ACCEPTED, 2: ACCEPTED}
    )
    assert all(outcome.good for outcome in outcomes.values())
    assert [line.partition("s  ")[2] for line in shown] == [
        "0 of 2 armed; vehicles 1, 2: phase arm",
        "1 of 2 armed; vehicle 2: phase arm",
        "2 of 2 armed",
    ]


def test_reports_older_than_the_command_do_not_count() -> None:
    old = with_fields(report(P.READY, armed=False), command_number=6)
    outcomes, shown = waited(Reported({1: old}, {1: report(P.ARMED)}), {1: ACCEPTED})
    assert outcomes[1].good
    assert len(shown) == 1


def test_a_failed_vehicle_does_not_hold_up_the_wait() -> None:
    event = Notice(Code.PROCEDURE_FAILED, "arm -> ready (arm failed: no answer)")
    failed = report(P.READY, armed=False, last_event=event)
    outcomes, _ = waited(Reported({1: failed}), {1: ACCEPTED, 2: REFUSED})
    end = outcomes[1].end
    assert end
    assert (end.finished, end.notice.code) == (False, Code.ACTION_FAILED)
    assert "PROCEDURE_FAILED: arm -> ready" in end.notice.text
    assert outcomes[2].end is None


def test_a_wait_that_takes_too_long_is_ended() -> None:
    outcomes, _ = waited(Reported({1: report(P.ARM, armed=False)}), {1: ACCEPTED, 2: ACCEPTED}, timeout_s=0.1)
    ends = [outcome.end for outcome in outcomes.values()]
    assert [end.notice.code for end in ends if end] == [Code.ACTION_TIMED_OUT] * 2
    assert "no new report" in str(ends[1])


def formation_report(flown: int, waiting: int, code: Code = Code.FORMATION_ACCEPTED) -> Status:
    slot = FlownSlot(ZERO3, formation=flown, waiting=waiting, moves_for_s=2.0)
    return report(
        P.FORMATION, slot=slot, last_event=Notice(code, "formation 3 does not begin: vehicle 1 does not have it")
    )


class VirtualClock:
    """Passes the time of each sleep at once."""

    def __init__(self) -> None:
        self.time_s = 0.0

    def now_s(self) -> float:
        return self.time_s

    def sleep(self, seconds: float) -> None:
        self.time_s += seconds


@pytest.mark.parametrize(
    ("reports", "within_s"),
    [
        ([formation_report(2, 3), formation_report(2, 2, Code.FORMATION_CANCELLED)], 0.2),
        ([formation_report(2, 2, Code.FORMATION_CANCELLED)], NOT_HELD_S + 0.2),  # it was never seen waiting
    ],
)
def test_a_change_that_a_vehicle_has_cancelled_ends_the_wait(reports: list[Status], within_s: float) -> None:
    goal, clock = goal_of(C.FORMATION, FormationChange(3, (), 0.0, 1.0), running=True), VirtualClock()
    assert goal
    given = Reported(*({1: one} for one in reports))
    outcome = wait_for(goal, {1: ACCEPTED}, given.newest, 300.0, lambda _: None, clock)[1]
    assert outcome.end and not outcome.good
    assert outcome.end.notice.code is Code.ACTION_FAILED
    assert "has cancelled it; last event FORMATION_CANCELLED" in outcome.end.notice.text
    assert clock.time_s <= within_s


@pytest.mark.parametrize(("flown", "waiting"), [(2, 3), (3, 3), (3, 4), (4, 4)])
def test_a_change_that_waits_or_was_replaced_is_not_cancelled(flown: int, waiting: int) -> None:
    goal = goal_of(C.FORMATION, FormationChange(3, (), 0.0, 1.0), running=True)
    assert goal and goal.held(formation_report(flown, waiting))


def test_a_reference_that_no_longer_waits_is_cancelled() -> None:
    goal = goal_of(C.REFERENCE, ReferenceChange(3, {}, 0.0), running=True)
    assert goal
    assert goal.held(report(P.FORMATION, reference=HeldReference(2, 3)))
    assert not goal.held(report(P.FORMATION, reference=HeldReference(2, 2)))


def test_vehicles_in_one_phase_are_listed_together() -> None:
    goal = Goal("armed", 1.0, lambda _: False)
    assert progress_text(goal, {}, {1: report(P.ARM), 3: None, 2: report(P.ARM)}, 3) == (
        "0 of 3 armed; vehicle 3: no new report; vehicles 1, 2: phase arm"
    )
