"""Events between two reports, and the ring that keeps them."""

from __future__ import annotations

from msgspec.structs import replace

from common import with_fields
from companion.monitor.events import EVENTS_KEPT, EventLog, Happening, compare_reports, describe_command, describe_reply
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code, Notice
from ground_fleet import STATUS

RESET = Notice(Code.POSITION_RESET, "position reset by 0.4 m followed")


def test_a_new_last_event_is_an_event_once() -> None:
    after = replace(STATUS, last_event=RESET)
    assert list(compare_reports(STATUS, after)) == [("event", "POSITION_RESET", RESET.text)]
    assert list(compare_reports(after, after)) == []


def test_a_change_of_phase_is_one_event_with_the_text_of_the_agent() -> None:
    notice = Notice(Code.PHASE_CHANGED, "formation -> release: leader lost")
    after = replace(STATUS, phase=FlightPhase.RELEASE, last_event=notice)
    assert list(compare_reports(STATUS, after)) == [("phase", "PHASE_CHANGED", notice.text)]


def test_a_change_of_phase_is_seen_without_its_event() -> None:
    """Another event of the same tick came after it."""
    after = replace(STATUS, phase=FlightPhase.RELEASE, last_event=RESET)
    assert list(compare_reports(STATUS, after)) == [
        ("phase", "PHASE_CHANGED", "formation -> release"),
        ("event", "POSITION_RESET", RESET.text),
    ]


def test_a_restart_of_the_agent_is_an_event() -> None:
    assert [code for _, code, _ in compare_reports(STATUS, with_fields(STATUS, session=2))] == ["AGENT_STARTED"]


def test_the_log_gives_what_is_newer_and_forgets_the_oldest() -> None:
    log = EventLog()
    for i in range(EVENTS_KEPT + 5):
        log.add(Happening(float(i), "platoon", 1, "event", "CODE", str(i)))
    assert len(log.all()) == EVENTS_KEPT
    assert [event.text for event in log.after(log.last_id - 2)] == [str(EVENTS_KEPT + 3), str(EVENTS_KEPT + 4)]
    assert log.after(log.last_id) == ()
    assert len(log.after(0)) == EVENTS_KEPT
    ids = [event.id for event in log.all()]
    assert ids == list(range(ids[0], ids[0] + EVENTS_KEPT))


def test_an_answer_names_the_operator_and_the_reason() -> None:
    reply = CommandReply(1, 3, False, Code.OTHER_HOLDS_COMMAND, "anna@ground holds command", "ben@laptop")
    found = describe_reply(5.0, "platoon", reply)
    assert (found.kind, found.vehicle_id, found.code) == ("answer", 1, "OTHER_HOLDS_COMMAND")
    assert found.text == "refused for ben@laptop: anna@ground holds command"


def test_a_change_of_leader_and_of_formation_is_seen_without_its_event() -> None:
    slot = replace(STATUS.formation.slot, formation=2)
    before = with_fields(STATUS, role=Role.FOLLOWER)
    after = replace(before, formation=replace(before.formation, slot=slot), last_event=RESET)
    after = with_fields(after, role=Role.LEADER, epoch=3)
    assert list(compare_reports(before, after)) == [
        ("leader", "ROLE_CHANGED", "follower -> leader in epoch 3"),
        ("formation", "FORMATION_CHANGED", f"formation {STATUS.formation.slot.formation} -> 2"),
        ("event", "POSITION_RESET", RESET.text),
    ]
    assert [kind for kind, _, _ in compare_reports(after, replace(before, last_event=RESET))] == ["formation"]


def test_a_command_and_its_answer_belong_together() -> None:
    command = describe_command(4.0, "platoon", 1, Command(CommandName.HOLD, 3, "ben@laptop", 1))
    answer = describe_reply(5.0, "platoon", CommandReply(1, 3, True, Code.PHASE_CHANGED, "hold", "ben@laptop"))
    assert command.given.command == answer.given.command
    assert answer.given == ("ben@laptop", command.given.command, "accepted")
    other = describe_reply(5.0, "platoon", CommandReply(2, 3, True, Code.PHASE_CHANGED, "hold", "ben@laptop"))
    assert other.given.command != command.given.command  # each vehicle counts its own
