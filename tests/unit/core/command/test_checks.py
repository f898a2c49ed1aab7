"""Checks of commands: the answer that the command would get, and nothing else. A twin that is not asked flies the same."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from msgspec.structs import replace

from companion.core.paced import STEPS_PER_TICK
from companion.types.commands import Command, CommandName, CommandReply, Content, Lead, ReferenceChange
from companion.types.flight import RULES, FlightPhase
from companion.types.notices import Code
from companion.types.tick import Outbox
from one_agent import AgentFlight
from tests.unit.core.formation.test_paced_changes import (
    LAP,
    TWELVE,
    changes_of,
    reference_of,
    until_answered,
    waypoints,
    wider,
)

C, P = CommandName, FlightPhase
ASKED = 1_700_000_000_000  # the number of a check: no command has one near it


def asked(
    flight: AgentFlight, name: CommandName, content: Content | None = None, operator: str = "anna@ground"
) -> Command:
    return replace(flight.command(name, operator, content), number=ASKED)


def without_replies(outbox: Outbox) -> Outbox:
    return replace(outbox, replies=())


def answers(flight: AgentFlight, checks: Sequence[Command], most: int = 100) -> list[CommandReply]:
    """The replies to checks that are sent once."""
    replies: list[CommandReply] = []
    for tick in range(most):
        replies += flight.tick(checks=() if tick else tuple(checks)).replies
        if len(replies) == len(checks):
            return replies
    raise AssertionError(f"{len(replies)} of {len(checks)} answered")


def flown(phase: FlightPhase, vehicle_id: int = 2) -> AgentFlight:
    flight = AgentFlight(vehicle_id)
    if vehicle_id == 1:
        flight.position = (0.0, 0.0, 0.0)
        flight.peer_position = (-1.5, 0.0, 1.0)
    flight.peer_reference_s = 30.0
    return flight.fly_to(phase) if phase is not P.OBSERVE else flight


@pytest.mark.parametrize("phase", [P.OBSERVE, P.READY, P.ARMED, P.HOLD, P.FORMATION])
def test_a_check_says_what_the_command_would_get_and_changes_nothing(phase: FlightPhase) -> None:
    checked, twin = flown(phase), flown(phase)
    for _ in range(5):
        assert checked.tick() == twin.tick()
    verdicts = {}
    for name in RULES:
        check = asked(checked, name)
        (reply,) = checked.tick(checks=(check,)).replies
        assert (reply.number, reply.operator) == (ASKED, check.operator)
        twin.tick()
        verdicts[name] = reply
        for _ in range(3):
            assert checked.tick() == twin.tick()
    assert not {reply.code for reply in verdicts.values() if reply.accepted} - {Code.CHECK_PASSED}
    for name, verdict in verdicts.items():
        (reply,) = flown(phase).tick(name).replies
        assert reply.accepted == verdict.accepted, name
        if not reply.accepted:
            assert (reply.code, reply.reason) == (verdict.code, verdict.reason)
        else:
            assert verdict.reason == f"would be accepted: {reply.reason}"


def test_a_check_of_a_new_leader_changes_no_role() -> None:
    flight, twin = flown(P.HOLD), flown(P.HOLD)
    contents = [Lead((1,), 3), Lead((2,), 3), Lead((), 3)]
    replies = answers(flight, [asked(flight, C.LEAD, content) for content in contents])
    assert [reply.code for reply in replies] == [Code.CHECK_PASSED, Code.NOT_A_LEADER, Code.NO_LEADER_NAMED]
    twin.tick()
    assert flight.tick() == twin.tick()
    assert [reply.code for reply in flight.tick(C.LEAD, lead=contents[0]).replies] == [Code.ROLE_CHANGED]


# ---------------------------------------------------------------- who may ask, and what a check uses up


def test_a_check_takes_neither_command_nor_a_number() -> None:
    flight = flown(P.OBSERVE)
    flight.tick()
    assert [reply.code for reply in answers(flight, [asked(flight, C.PREPARE)])] == [Code.CHECK_PASSED]
    status = next(status for _ in range(9) if (status := flight.tick().status))
    assert (status.command.holder, status.command.command_number) == ("", 0)
    assert [reply.code for reply in flight.tick(C.PREPARE).replies] == [Code.PHASE_CHANGED]
    assert status.command.command_number < flight.agent.arbitration.number < ASKED


def test_only_who_may_command_is_answered_and_only_by_this_start_of_the_agent() -> None:
    flight = flown(P.READY)  # anna holds command
    other = asked(flight, C.ARM, operator="boris")
    earlier = replace(asked(flight, C.ARM), session=1)
    codes = [reply.code for reply in answers(flight, [other, earlier])]
    assert codes == [Code.OTHER_HOLDS_COMMAND, Code.WRONG_SESSION]


@pytest.mark.parametrize("name", [C.ABORT, C.TAKE])
def test_abort_and_take_have_no_check(name: CommandName) -> None:
    flight = flown(P.ARMED)
    (reply,) = answers(flight, [asked(flight, name, operator="anna@ground")])
    assert not reply.accepted
    assert flight.agent.phase is P.ARMED
    assert flight.agent.arbitration.holder == "anna@ground"


# ---------------------------------------------------------------- changes


def twelve() -> AgentFlight:
    flight = AgentFlight(fleet=TWELVE, reference=LAP)
    flight.peer_reference_s = 30.0
    for _ in range(5):
        flight.tick()
    return flight


def test_a_formation_far_too_wide_is_refused_with_the_scale_that_fits() -> None:
    flight, twin = twelve(), twelve()
    wide = wider(1, flight.peer_reference_s + 1.0, by=200.0)
    (reply,) = answers(flight, [asked(flight, C.FORMATION, wide)])
    assert (reply.accepted, reply.code) == (False, Code.SLOT_OUTSIDE_FENCE)
    ((key, scale),) = reply.accepts
    assert key == "scale"
    for factor, accepted in ((scale, True), (1.02 * scale, False)):
        fits = wider(1, flight.peer_reference_s + 1.0, by=200.0 * factor)
        (reply,) = answers(flight, [asked(flight, C.FORMATION, fits)])
        assert reply.accepted == accepted, reply
    while twin.now_s < flight.now_s:
        twin.tick()
    assert without_replies(flight.tick()) == without_replies(twin.tick())  # none was taken
    given = flight.command(C.FORMATION, content=wider(1, flight.peer_reference_s + 1.0, by=200.0 * scale))
    (reply,), _ = until_answered(flight, [given])
    assert reply.code is Code.FORMATION_ACCEPTED


def test_a_reference_too_fast_is_refused_with_the_speed_and_acceleration_that_are_accepted() -> None:
    flight = twelve()
    described = waypoints(3, 2.0)
    (reply,) = answers(flight, [asked(flight, C.REFERENCE, ReferenceChange(1, described, 32.0))])  # type: ignore[arg-type]
    assert (reply.accepted, reply.code) == (False, Code.REFERENCE_INVALID)
    accepts = dict(reply.accepts)
    assert accepts.keys() == {"max_speed_m_s", "max_acceleration_m_s2"}
    assert (
        f"at most {accepts['max_acceleration_m_s2']:g} m/s^2 with max_speed_m_s {accepts['max_speed_m_s']:g}"
        in reply.reason
    )
    slower = ReferenceChange(1, described | accepts, flight.peer_reference_s + 2.0)  # type: ignore[arg-type]
    (reply,) = answers(flight, [asked(flight, C.REFERENCE, slower)])
    assert reply.accepted, reply
    held = flight.tick().peer_packet
    assert held is not None
    assert held.reference is not None
    assert (held.reference.flown, held.reference.waiting) == (0, 0)


def test_what_is_accepted_passes_the_later_checks_too() -> None:
    """Too fast for the limits of the fleet: whether the law follows is judged only of one that is slow enough for them."""
    flight = twelve()
    described = {"kind": "circle", "centre_enu_m": [0.0, 0.0, 5.0], "radius_m": 4.0, "period_s": 10.0, "ramp_s": 0.5}
    refused = asked(flight, C.REFERENCE, ReferenceChange(1, described, flight.peer_reference_s + 2.0))  # type: ignore[arg-type]
    (reply,) = answers(flight, [refused])
    assert not reply.accepted
    slower = ReferenceChange(1, described | dict(reply.accepts), flight.peer_reference_s + 2.0)  # type: ignore[arg-type]
    (reply,) = answers(flight, [asked(flight, C.REFERENCE, slower)])
    assert reply.accepted, reply


def test_a_check_that_takes_long_is_answered_once_and_delays_no_command() -> None:
    flight = twelve()
    check = asked(flight, C.REFERENCE, ReferenceChange(1, waypoints(200), flight.peer_reference_s + 3.0))  # type: ignore[arg-type]
    assert flight.tick(checks=(check,)).replies == ()
    assert flight.tick(checks=(check,)).replies == ()  # sent again meanwhile
    alone = twelve()
    for _ in range(2):
        alone.tick()
    (given,), steps = until_answered(flight, [reference_of(flight, 1, waypoints(150))])
    (same,), undelayed = until_answered(alone, [reference_of(alone, 1, waypoints(150))])
    assert (given.accepted, given.code) == (same.accepted, same.code)
    assert len(steps) == len(undelayed)
    replies = [reply for _ in range(100) for reply in flight.tick().replies]
    assert [reply.number for reply in replies] == [ASKED]
    assert changes_of(flight).checks.steps > 0


def test_a_newer_check_takes_the_place_of_one_under_way() -> None:
    flight = twelve()
    begins_s = flight.peer_reference_s + 3.0
    first = asked(flight, C.REFERENCE, ReferenceChange(1, waypoints(200), begins_s))  # type: ignore[arg-type]
    second = replace(asked(flight, C.REFERENCE, ReferenceChange(1, waypoints(3), begins_s)), number=ASKED + 1)  # type: ignore[arg-type]
    assert flight.tick(checks=(first,)).replies == ()
    before = changes_of(flight).checks.steps
    (displaced,) = flight.tick(checks=(second,)).replies
    assert (displaced.number, displaced.code) == (ASKED, Code.CHANGE_IN_PROGRESS)
    assert changes_of(flight).checks.steps - before <= STEPS_PER_TICK
    replies = [reply for _ in range(100) for reply in flight.tick().replies]
    assert [(reply.number, reply.accepted) for reply in replies] == [(ASKED + 1, True)]
