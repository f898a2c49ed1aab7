"""systemd's journal with fields: what is logged of a code, a vehicle or a phase can be searched for.

Its native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL) is one datagram for each entry, so no library is needed. Used where
standard error leads to the journal; a line that the journal does not take goes to standard error.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Mapping

from companion.link.log import DroppingHandler, PrintableFormatter, log_to, log_to_stderr, write_line

JOURNAL_SOCKET = "/run/systemd/journal/socket"
IDENTIFIER = "companion"
_PRIORITIES = ((logging.CRITICAL, 2), (logging.ERROR, 3), (logging.WARNING, 4), (logging.INFO, 6))
_DEBUG = 7


def leads_to_journal(descriptor: int, environment: Mapping[str, str] = os.environ) -> bool:
    """Whether the descriptor is the stream to the journal that systemd gave to this process."""
    try:
        status = os.fstat(descriptor)
    except OSError:
        return False
    return environment.get("JOURNAL_STREAM") == f"{status.st_dev}:{status.st_ino}"


def entry(fields: Mapping[str, str]) -> bytes:
    """The datagram of one entry. A value of several lines is preceded by its length."""
    parts = []
    for name, text in fields.items():
        value = text.encode(errors="replace")
        if b"\n" in value:
            parts.append(name.encode() + b"\n" + len(value).to_bytes(8, "little") + value + b"\n")
        else:
            parts.append(name.encode() + b"=" + value + b"\n")
    return b"".join(parts)


class JournalHandler(DroppingHandler):
    """Sends entries to the journal in a thread of its own; see DroppingHandler for a journal that hangs."""

    def __init__(
        self, descriptor: int, vehicle_id: int, phase: Callable[[], str], address: str = JOURNAL_SOCKET
    ) -> None:
        """`descriptor` gets the lines that the journal refuses. `phase` is that of the agent when a line is logged."""
        self._address = address
        self._vehicle_id = vehicle_id
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        self._phase = phase
        super().__init__(descriptor)

    def _made(self, record: logging.LogRecord, text: str) -> tuple[bytes, str]:
        """The datagram, and the line for standard error."""
        fields = {
            "MESSAGE": text,
            "PRIORITY": str(_priority(record.levelno)),
            "SYSLOG_IDENTIFIER": IDENTIFIER,
            "COMPANION_VEHICLE": str(self._vehicle_id),
            "COMPANION_PHASE": self._phase(),
        }
        if code := getattr(record, "companion_code", ""):
            fields["COMPANION_CODE"] = code
        return entry(fields), text

    def _write(self, made: tuple[bytes, str]) -> None:
        datagram, text = made
        try:
            self._socket.sendto(datagram, self._address)
        except OSError:  # no journal, or an entry that is too large for it
            write_line(self._descriptor, text)


def _priority(level: int) -> int:
    return next((priority for least, priority in _PRIORITIES if level >= least), _DEBUG)


def log_as_service(vehicle_id: int, phase: Callable[[], str]) -> None:
    """Log to the journal where standard error leads there, else to standard error. The journal has the time itself."""
    descriptor = sys.stderr.fileno()
    if not leads_to_journal(descriptor):
        log_to_stderr(vehicle_id)
        return
    handler = JournalHandler(descriptor, vehicle_id, phase)
    log_to(handler, PrintableFormatter(f"vehicle {vehicle_id}: %(message)s"))
