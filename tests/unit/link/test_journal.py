"""Entries of the journal, received by a real datagram socket in place of journald."""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.link.log import COMMAND, LINES_KEPT, AgentEventLog, CommandLog, PrintableFormatter, RejectionLog
from companion.link.systemd import JournalHandler, entry, leads_to_journal
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.notices import Code, Notice


def fields(datagram: bytes) -> dict[str, str]:
    """An entry, read as the protocol's description has it."""
    read = {}
    while datagram:
        line, _, rest = datagram.partition(b"\n")
        name, separator, value = line.partition(b"=")
        if not separator:
            size, rest = int.from_bytes(rest[:8], "little"), rest[8:]
            value, end, rest = rest[:size], rest[size : size + 1], rest[size + 1 :]
            assert end == b"\n"
        read[name.decode()] = value.decode()
        datagram = rest
    return read


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[socket.socket]:
    with closing(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)) as made:
        made.bind(str(tmp_path / "socket"))
        made.settimeout(10.0)
        yield made


@pytest.fixture
def logger() -> Iterator[logging.Logger]:
    """That of companion/link/log.py, without the handlers of the test program."""
    made = logging.getLogger("companion.link.log")
    level, made.propagate = made.level, False
    made.setLevel(logging.INFO)
    yield made
    made.handlers.clear()
    made.setLevel(level)
    made.propagate = True


def handler_to(address: str, descriptor: int = 2, phase: Callable[[], str] = lambda: "hold") -> JournalHandler:
    handler = JournalHandler(descriptor, 3, phase, address)
    handler.setFormatter(PrintableFormatter("vehicle 3: %(message)s"))
    return handler


def test_an_event_can_be_found_by_code_vehicle_and_phase(journal: socket.socket, logger: logging.Logger) -> None:
    phases = iter(["formation", "hold"])
    logger.addHandler(handler_to(journal.getsockname(), phase=lambda: next(phases)))
    AgentEventLog().log(Notice(Code.LEADER_LOST, "no fresh leader beacon"), 100.0)
    AgentEventLog().log(Notice(Code.PHASE_CHANGED, "formation -> hold"), 100.0)
    assert fields(journal.recv(65536)) == {
        "MESSAGE": "vehicle 3: LEADER_LOST: no fresh leader beacon",
        "PRIORITY": "4",
        "SYSLOG_IDENTIFIER": "companion",
        "COMPANION_VEHICLE": "3",
        "COMPANION_PHASE": "formation",
        "COMPANION_CODE": "LEADER_LOST",
    }
    second = fields(journal.recv(65536))
    assert (second["PRIORITY"], second["COMPANION_CODE"], second["COMPANION_PHASE"]) == ("6", "PHASE_CHANGED", "hold")


def test_commands_and_rejections_have_their_codes(journal: socket.socket, logger: logging.Logger) -> None:
    logger.addHandler(handler_to(journal.getsockname()))
    command = Command(CommandName.ARM, 12, "anna@ground", 7)
    CommandLog().log(COMMAND, command, CommandReply(1, 12, False, Code.COMMAND_OLD, "old", "anna@ground"), 100.0)
    RejectionLog().update({"WIRE_VERSION_DIFFERS 9": 5}, 100.0)
    assert fields(journal.recv(65536))["COMPANION_CODE"] == "COMMAND_OLD"
    assert fields(journal.recv(65536))["COMPANION_CODE"] == "WIRE_VERSION_DIFFERS"


def test_an_exception_is_one_entry_of_several_lines(journal: socket.socket) -> None:
    try:
        raise ValueError("broken")
    except ValueError:
        record = logging.LogRecord("companion", logging.CRITICAL, "", 0, "it fails", None, sys.exc_info())
    handler_to(journal.getsockname()).handle(record)
    read = fields(journal.recv(65536))
    assert read["PRIORITY"] == "2"
    assert read["MESSAGE"].startswith("vehicle 3: it fails\nTraceback")
    assert "COMPANION_CODE" not in read


@given(st.dictionaries(st.from_regex("[A-Z][A-Z_]{0,20}", fullmatch=True), st.text(), max_size=6))
def test_no_text_changes_another_field(given_fields: dict[str, str]) -> None:
    printable = {name: text.encode(errors="replace").decode() for name, text in given_fields.items()}
    assert fields(entry(given_fields)) == printable


def record(text: str) -> logging.LogRecord:
    return logging.LogRecord("companion", logging.INFO, "", 0, text, None, None)


def test_without_a_journal_lines_go_to_standard_error(tmp_path: Path) -> None:
    reads, writes = os.pipe()
    handler = handler_to(str(tmp_path / "missing"), writes)
    handler.handle(record("takeoff -> hold"))
    handler.flush()
    assert os.read(reads, 4096) == b"vehicle 3: takeoff -> hold\n"
    os.close(reads)
    os.close(writes)


def test_an_entry_that_is_too_large_goes_to_standard_error(journal: socket.socket, tmp_path: Path) -> None:
    with (tmp_path / "stderr").open("wb") as lines:
        handler = handler_to(journal.getsockname(), lines.fileno())
        handler.handle(record("x" * 10_000_000))
        handler.flush()
        handler.handle(record("small"))
        assert fields(journal.recv(65536))["MESSAGE"] == "vehicle 3: small"
    assert (tmp_path / "stderr").stat().st_size > 10_000_000


def test_a_journal_that_hangs_drops_lines_and_never_blocks(journal: socket.socket) -> None:
    """With a send in the caller's thread the loop would never end."""
    handler = handler_to(journal.getsockname(), os.open(os.devnull, os.O_WRONLY))
    for _ in range(2 * LINES_KEPT + 1000):
        handler.handle(record("x" * 999))
    assert handler.dropped > 0
    while "lines dropped before" not in fields(journal.recv(65536))["MESSAGE"]:
        handler.handle(record("after"))


def test_the_stream_that_systemd_gave_is_known_by_its_inode() -> None:
    reads, writes = os.pipe()
    status = os.fstat(writes)
    assert leads_to_journal(writes, {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino}"})
    assert not leads_to_journal(writes, {"JOURNAL_STREAM": f"{status.st_dev}:{status.st_ino + 1}"})
    assert not leads_to_journal(writes, {})
    os.close(reads)
    os.close(writes)
    assert not leads_to_journal(writes, {"JOURNAL_STREAM": "0:0"})
