"""A stand-in's own logs of its flights, in memory: from arming on, in the format that its autopilot writes.

Real formats and few topics, so that what reads the logs of the real ones reads these, too, and a client is tested with what
it will meet. What they hold is the estimate, as it is with the real ones.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf
from typing import Protocol

PERIOD_S = 0.1
EPSILON_S = 1e-6


class Logged(Protocol):
    """What of an autopilot a log needs to know; what its rows hold is the format's business."""

    armed: bool
    time_s: float


class LogFormat(Protocol):
    """How one make of autopilot writes."""

    def head(self) -> bytes:
        """What a file begins with."""

    def row(self) -> bytes:
        """How the vehicle is now."""


@dataclass(slots=True)
class FlightLog:
    """One file. `written_s` is when it last grew, on the autopilot's clock."""

    content: bytearray
    written_s: float


@dataclass(slots=True)
class FlightLogs:
    """All of one vehicle's, the oldest first. Without `utc_at_start_s` the autopilot does not know the date."""

    log_format: LogFormat
    after_disarming_s: float
    utc_at_start_s: float = 0.0
    files: list[FlightLog] = field(default_factory=list)
    _paused: bool = False
    _open: FlightLog | None = None
    _armed_s: float = -inf
    _next_s: float = 0.0

    def write(self, vehicle: Logged) -> None:
        """A row, where one is due."""
        if vehicle.armed:
            self._armed_s = vehicle.time_s
        if (self._paused and not vehicle.armed) or vehicle.time_s - self._armed_s > self.after_disarming_s:
            self._open = None
            return
        if self._open is None:
            self._open = FlightLog(bytearray(self.log_format.head()), vehicle.time_s)
            self.files.append(self._open)
        if vehicle.time_s >= self._next_s - EPSILON_S:
            self._next_s = vehicle.time_s + PERIOD_S
            self._open.content += self.log_format.row()
            self._open.written_s = vehicle.time_s

    def pause(self) -> None:
        """Ends the open log, and writes nothing while disarmed."""
        self._paused, self._open = True, None

    def resume(self) -> None:
        """In a new log, where there is still something to write."""
        self._paused = False

    def utc_s(self, time_s: float) -> int:
        """A time of the autopilot's clock as LOG_ENTRY tells it."""
        return int(self.utc_at_start_s + time_s)

    def erase(self) -> None:
        self.files.clear()
        self._open = None
