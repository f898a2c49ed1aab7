"""The log: each event is a line, and no flood of messages fills the disk."""

import logging

import pytest

from companion.link.log import BURST, CommandLog, EventLog, RejectionLog
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.notices import Code, Notice

TAKE = Command(CommandName.TAKE, 12, "mallory@hill", 7)
TAKEN = CommandReply(1, 12, True, Code.COMMAND_TAKEN, "mallory@hill takes command", "mallory@hill")


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records]


def test_each_command_is_logged_and_a_flood_is_counted(caplog: pytest.LogCaptureFixture) -> None:
    log, command = CommandLog(), Command(CommandName.ARM, 12, "anna@ground", 7)
    with caplog.at_level(logging.INFO):
        for _ in range(BURST + 30):
            log.answered(command, CommandReply(1, 12, False, Code.COMMAND_OLD, "old command", "anna@ground"), 100.5)
        log.answered(command, CommandReply(1, 12, True, Code.PHASE_CHANGED, "arm", "anna@ground"), 100.6)
        log.answered(command, CommandReply(1, 12, False, Code.COMMAND_OLD, "old command", "anna@ground"), 102.0)
    assert lines(caplog)[0] == "command arm, number 12 of anna@ground: refused, COMMAND_OLD: old command"
    assert lines(caplog)[BURST:] == [
        "command arm, number 12 of anna@ground: accepted, PHASE_CHANGED: arm",
        "command arm, number 12 of anna@ground: refused, COMMAND_OLD: old command (30 more of COMMAND_OLD left out before)",
    ]


def test_a_flood_of_takes_is_a_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    events, commands = EventLog(), CommandLog()
    with caplog.at_level(logging.INFO):
        for tick in range(14 * 50):
            now_s = 100.0 + 0.02 * tick
            events.happened(Notice(Code.COMMAND_TAKEN, "mallory@hill takes command from anna@ground"), now_s)
            commands.answered(
                TAKE, CommandReply(1, 12, True, Code.COMMAND_TAKEN, "mallory@hill takes command", "anna@ground"), now_s
            )
    assert sum(map(len, lines(caplog))) < 10_000


def test_a_flood_of_foreign_versions_is_a_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    log = RejectionLog()
    with caplog.at_level(logging.INFO):
        for second in range(14):
            counts = {f"{Code.WIRE_VERSION_DIFFERS} {version}": 50 * (second + 1) for version in range(255)}
            log.update(counts, 100.0 + second)
    assert sum(map(len, lines(caplog))) < 10_000
