"""Flight logs of a stand-in, in memory: from arming on, in the format of its type; and the common part of their transfer.

The formats are the real ones with few topics, so that programs that read real logs read these, too. They contain the
estimate, as real logs do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from math import inf
from typing import Protocol

from companion.mavlink.codec import MavlinkMessage, mavlink

Answers = Iterator[MavlinkMessage]
Handler = Callable[[MavlinkMessage], Answers | None]  # of an incoming message; None: without answers
PERIOD_S = 0.1
EPSILON_S = 1e-6
CHUNK_BYTES = 90  # of LOG_DATA


class Logged(Protocol):
    """The state of an autopilot that starts and ends a log; the format reads what its rows contain."""

    armed: bool
    time_s: float


@dataclass(slots=True)
class FlightLog:
    """One file. `written_s` is the time of its last row, on the autopilot's clock."""

    content: bytearray
    written_s: float


@dataclass(slots=True)
class StandInLogs:
    """All logs of one vehicle, the oldest first. Without `utc_at_start_s` the autopilot does not know the date.

    The format is that of its type: `head` is the beginning of a file, `row` the present state of the vehicle.
    """

    head: Callable[[], bytes]
    row: Callable[[], bytes]
    after_disarming_s: float
    utc_at_start_s: float = 0.0
    files: list[FlightLog] = field(default_factory=list)
    _paused: bool = False
    _open: FlightLog | None = None
    _armed_s: float = -inf
    _next_s: float = 0.0

    def write(self, vehicle: Logged) -> None:
        """Append a row if one is due."""
        if vehicle.armed:
            self._armed_s = vehicle.time_s
        if (self._paused and not vehicle.armed) or vehicle.time_s - self._armed_s > self.after_disarming_s:
            self._open = None
            return
        if self._open is None:
            self._open = FlightLog(bytearray(self.head()), vehicle.time_s)
            self.files.append(self._open)
        if vehicle.time_s >= self._next_s - EPSILON_S:
            self._next_s = vehicle.time_s + PERIOD_S
            self._open.content += self.row()
            self._open.written_s = vehicle.time_s

    def pause(self) -> None:
        """End the open log and write nothing while disarmed."""
        self._paused, self._open = True, None

    def resume(self) -> None:
        """Write again, into a new log."""
        self._paused = False

    def utc_s(self, time_s: float) -> int:
        """A time of the autopilot's clock as UTC for LOG_ENTRY."""
        return int(self.utc_at_start_s + time_s)

    def erase(self) -> None:
        self.files.clear()
        self._open = None


class LogTransfer(Protocol):
    """Log transfer on one link. A request has its immediate answers and changes what `due` sends."""

    requests: dict[str, Handler]

    def due(self) -> Answers:
        """LOG_ENTRY and LOG_DATA of one step."""


def log_requests(listed: Handler, data: Handler, end: Handler, erase: Handler) -> dict[str, Handler]:
    """The requests of the log protocol, each with what handles it."""
    return {"LOG_REQUEST_LIST": listed, "LOG_REQUEST_DATA": data, "LOG_REQUEST_END": end, "LOG_ERASE": erase}


def log_data(number: int, offset: int, content: bytes) -> MavlinkMessage:
    """LOG_DATA; the last packet of a file is padded with zeros."""
    return mavlink.MAVLink_log_data_message(number, offset, len(content), list(content.ljust(CHUNK_BYTES, b"\0")))
