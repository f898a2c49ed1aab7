"""systemd: sd_notify(3) says that the agent is ready, alive and stopping; its journal gets log lines with fields.

The journal's native protocol (systemd.io/JOURNAL_NATIVE_PROTOCOL) is one datagram for each entry, so no library is needed. It
is used where standard error leads to the journal; a line that the journal does not take goes to standard error.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
from collections.abc import Callable, Mapping

from companion.link.log import DroppingHandler, PrintableFormatter, log_to, log_to_stderr, write_line
from companion.types.status import Status

MIN_WATCHDOG_PERIOD_S = 0.2  # a few times per second are enough for any WatchdogSec


class Notifier:
    """Sends notifications to $NOTIFY_SOCKET; does nothing where systemd did not start this process.

    Only completed control cycles feed the watchdog. A process that hangs or a loop that stops ticking triggers it.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        if self._address.startswith("@"):
            self._address = "\0" + self._address[1:]  # abstract socket name of Linux
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if self._address else None
        if self._socket:
            self._socket.setblocking(False)  # the control loop never waits for the service manager
        self._watchdog_period_s = _watchdog_period_s(environment)
        self._fed_s = float("-inf")
        self._is_ready = False
        self._status = ""

    def complete_cycle(self, now_s: float, links_up: bool) -> None:
        """Report a completed control cycle. The first one with autopilot and fleet link makes the service ready."""
        if links_up and not self._is_ready:
            self._is_ready = self._send("READY=1")
        is_due = self._watchdog_period_s is not None and now_s - self._fed_s >= self._watchdog_period_s
        if is_due and self._send("WATCHDOG=1"):
            self._fed_s = now_s

    def status(self, text: str) -> None:
        """Set the status line of `systemctl status`; sent only when it changes."""
        if text != self._status and self._send(f"STATUS={text}"):
            self._status = text

    def stopping(self) -> None:
        """Report that the agent is stopping."""
        self._send("STOPPING=1")

    def close(self) -> None:
        if self._socket:
            self._socket.close()
            self._socket = None

    def _send(self, message: str) -> bool:
        """Whether the message was sent. A failure is ignored: the agent flies without its service manager."""
        if not self._socket:
            return False
        try:
            self._socket.sendto(message.encode(), self._address)
        except OSError:
            return False
        return True


def status_line(status: Status) -> str:
    """Phase and health flags of a vehicle: what `systemctl status` shows of it."""
    return f"{status.phase}; {', '.join(status.safety.flags) or 'no flags'}"


def _watchdog_period_s(environment: Mapping[str, str]) -> float | None:
    """A quarter of WATCHDOG_USEC, or None where no watchdog supervises this process."""
    limit_us = environment.get("WATCHDOG_USEC", "")
    process = environment.get("WATCHDOG_PID", "")
    if not limit_us.isdigit() or int(limit_us) == 0 or (process and process != str(os.getpid())):
        return None
    return max(MIN_WATCHDOG_PERIOD_S, int(limit_us) / 1e6 / 4)


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

    def _make(self, record: logging.LogRecord, text: str) -> tuple[bytes, str]:
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
