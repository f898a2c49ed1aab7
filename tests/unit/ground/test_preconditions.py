"""takeoff and return are for all vehicles or none, by their reports."""

import pytest

from common import with_fields
from companion.ground.answers import AnswerKind, Outcome
from companion.ground.goals import advise_divided_fleet, check_all
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag
from companion.types.notices import Code, Notice
from companion.types.status import Status
from ground_fleet import directed_status

P, C, F = FlightPhase, CommandName, HealthFlag
TOO_CLOSE = Notice(Code.RETURN_PATH_TOO_CLOSE, "separation: 0.4 m")


def report(vehicle_id: int, phase: FlightPhase, **more: object) -> Status:
    return with_fields(directed_status(vehicle_id), phase=phase, **({"flags": ()} | more))


def check(name: CommandName, *reports: Status) -> dict[int, Outcome]:
    return check_all(name, (1, 2), {said.agent.vehicle_id: said for said in reports}, "anna", 3.0)


@pytest.mark.parametrize(
    ("name", "phases"),
    [
        (C.TAKEOFF, (P.ARMED, P.ARMED)),
        (C.TAKEOFF, (P.ARMED, P.HOLD)),  # again, after a part of the fleet took off
        (C.TAKEOFF, (P.TAKEOFF, P.ARMED)),
        (C.RETURN, (P.FORMATION, P.HOLD)),
        (C.RETURN, (P.RETURN, P.RELEASE)),
    ],
)
def test_nothing_is_held_back_where_all_can_begin(name: CommandName, phases: tuple[FlightPhase, FlightPhase]) -> None:
    first, second = phases
    assert check(name, report(1, first), report(2, second)) == {}


@pytest.mark.parametrize(
    ("name", "second", "code"),
    [
        (C.TAKEOFF, report(2, P.ARM), Code.WRONG_PHASE),
        (C.TAKEOFF, report(2, P.OBSERVE), Code.WRONG_PHASE),
        (C.TAKEOFF, report(2, P.ARMED, flags=(F.ATTITUDE_STALE,)), Code.ATTITUDE_STALE),
        (C.TAKEOFF, report(2, P.ARMED, holder="boris"), Code.OTHER_HOLDS_COMMAND),
        (C.RETURN, report(2, P.LAND), Code.WRONG_PHASE),
        (C.RETURN, report(2, P.HOLD, flags=(F.POSITION_STALE,)), Code.POSITION_STALE),
        (C.RETURN, report(2, P.HOLD, refuses_return=TOO_CLOSE), Code.RETURN_PATH_TOO_CLOSE),
    ],
)
def test_one_vehicle_that_cannot_begin_holds_back_all(name: CommandName, second: Status, code: Code) -> None:
    outcomes = check(name, report(1, P.ARMED if name is C.TAKEOFF else P.HOLD), second)
    assert [outcome.kind for outcome in outcomes.values()] == [AnswerKind.NOT_SENT] * 2
    assert outcomes[2].notice.code == code
    assert outcomes[1].notice.code == Code.NOT_SENT
    assert "vehicle 2 cannot begin" in outcomes[1].notice.text


def test_flags_that_do_not_matter_hold_nothing_back() -> None:
    assert check(C.TAKEOFF, report(1, P.ARMED, flags=(F.LEADER_LOST,)), report(2, P.ARMED, holder="anna")) == {}
    assert check(C.RETURN, report(1, P.HOLD, flags=(F.LEADER_LOST, F.OUTSIDE_FENCE)), report(2, P.HOLD)) == {}


def test_a_vehicle_without_a_report_holds_back_all() -> None:
    outcomes = check(C.TAKEOFF, report(1, P.ARMED))
    assert [outcome.kind for outcome in outcomes.values()] == [AnswerKind.NOT_SENT, AnswerKind.MISSING]
    assert outcomes[2].notice.code == Code.NO_REPORT


def outcome(kind: AnswerKind) -> Outcome:
    return Outcome(kind, Notice(Code.PHASE_CHANGED, ""))


@pytest.mark.parametrize(("name", "next_step"), [(C.TAKEOFF, "land --only 1 3"), (C.RETURN, "hold --only 1 3")])
def test_a_divided_fleet_is_named_with_the_next_step(name: CommandName, next_step: str) -> None:
    outcomes = {
        1: outcome(AnswerKind.ACCEPTED),
        2: outcome(AnswerKind.REFUSED),
        3: outcome(AnswerKind.ACCEPTED),
        4: outcome(AnswerKind.MISSING),
    }
    advice = advise_divided_fleet(name, outcomes)
    assert advice
    assert advice.code == Code.FLEET_DIVIDED
    assert f"vehicles 1, 3 began {name}, vehicles 2, 4 did not" in advice.text
    assert next_step in advice.text
    assert f"{name} --only 2 4" in advice.text


@pytest.mark.parametrize("kinds", [(AnswerKind.ACCEPTED,) * 2, (AnswerKind.REFUSED, AnswerKind.MISSING)])
def test_a_fleet_that_is_not_divided_needs_no_advice(kinds: tuple[AnswerKind, AnswerKind]) -> None:
    assert advise_divided_fleet(C.TAKEOFF, dict(enumerate(map(outcome, kinds)))) is None
    assert advise_divided_fleet(C.HOLD, {1: outcome(AnswerKind.ACCEPTED), 2: outcome(AnswerKind.REFUSED)}) is None
