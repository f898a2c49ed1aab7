"""The log: each event is a line, and no flood of messages fills the disk."""

import logging
import os
import subprocess
import sys
import threading

import pytest

from companion.link.log import (
    BURST,
    CHECK,
    COMMAND,
    LINES_KEPT,
    AgentEventLog,
    CommandLog,
    DroppingHandler,
    RejectionLog,
)
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
            log.log(COMMAND, command, CommandReply(1, 12, False, Code.COMMAND_OLD, "old command", "anna@ground"), 100.5)
        log.log(COMMAND, command, CommandReply(1, 12, True, Code.PHASE_CHANGED, "arm", "anna@ground"), 100.6)
        log.log(CHECK, command, CommandReply(1, 12, False, Code.COMMAND_OLD, "old command", "anna@ground"), 102.0)
    assert lines(caplog)[0] == "command arm, number 12 of anna@ground: refused, COMMAND_OLD: old command"
    assert lines(caplog)[BURST:] == [
        "command arm, number 12 of anna@ground: accepted, PHASE_CHANGED: arm",
        "check of arm, number 12 of anna@ground: refused, COMMAND_OLD: old command (30 more of COMMAND_OLD left out before)",
    ]


def test_a_flood_of_takes_is_a_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    events, commands = AgentEventLog(), CommandLog()
    with caplog.at_level(logging.INFO):
        for tick in range(14 * 50):
            now_s = 100.0 + 0.02 * tick
            events.log(Notice(Code.COMMAND_TAKEN, "mallory@hill takes command from anna@ground"), now_s)
            commands.log(
                COMMAND,
                TAKE,
                CommandReply(1, 12, True, Code.COMMAND_TAKEN, "mallory@hill takes command", "anna@ground"),
                now_s,
            )
    assert sum(map(len, lines(caplog))) < 10_000


def test_a_flood_of_foreign_versions_is_a_few_lines(caplog: pytest.LogCaptureFixture) -> None:
    log = RejectionLog()
    with caplog.at_level(logging.INFO):
        for second in range(14):
            counts = {f"{Code.WIRE_VERSION_DIFFERS} {version}": 50 * (second + 1) for version in range(255)}
            log.update(counts, 100.0 + second)
    assert sum(map(len, lines(caplog))) < 10_000


GIVEN = 2 * LINES_KEPT + 1000


def record(text: str) -> logging.LogRecord:
    return logging.LogRecord("companion", logging.INFO, "", 0, text, None, None)


def test_a_stream_that_is_not_read_drops_lines_and_never_blocks() -> None:
    """With a blocking handler the first loop would never end."""
    reads, writes = os.pipe()
    handler = DroppingHandler(writes)
    for _ in range(GIVEN):
        handler.handle(record("x" * 999))
    assert handler.dropped > 0  # since the last line that was kept
    received: list[bytes] = []
    reader = threading.Thread(target=lambda: received.extend(iter(lambda: os.read(reads, 65536), b"")))
    reader.start()
    handler.flush()
    handler.handle(record("the end"))
    handler.flush()
    os.close(writes)
    reader.join()
    os.close(reads)
    lines = b"".join(received).decode().splitlines()
    dropped = sum(int(line.partition("(")[2].split()[0]) for line in lines if "lines dropped before" in line)
    assert len(lines) + dropped == GIVEN + 1
    assert lines[-1].startswith("the end (")
    assert handler.dropped == 0


ENDS = """
import logging, sys
from companion.link.log import log_to_stderr
log_to_stderr(3)
for number in range(int(sys.argv[1])):
    logging.info("line %d %s", number, "x" * 999)
"""


def test_the_last_lines_are_written_before_the_process_ends() -> None:
    done = subprocess.run([sys.executable, "-c", ENDS, "50"], capture_output=True, text=True, check=True)
    assert " vehicle 3: line 49 x" in done.stderr


def test_what_is_printed_after_a_flush_comes_last() -> None:
    """As the reason why the agent ends."""
    code = f"{ENDS}\nimport os\nfrom companion.link.log import flush_log\nflush_log()\nos.write(2, b'the end\\n')\n"
    done = subprocess.run([sys.executable, "-c", code, "400"], capture_output=True, text=True, check=True)
    assert done.stderr.splitlines()[-1] == "the end"


def test_a_process_ends_although_its_log_is_not_read() -> None:
    with subprocess.Popen([sys.executable, "-c", ENDS, "2000"], stderr=subprocess.PIPE) as process:
        assert process.wait() == 0
