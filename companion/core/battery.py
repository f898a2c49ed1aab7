"""Who has too little battery left leaves formation by itself: into the autopilot's own hold, and down from there."""

from __future__ import annotations

from collections.abc import Iterable

from companion.core.succession import HELD
from companion.types import FlightPhase, SystemSample, Telemetry

LOW_FOR_S = 3.0  # one sample alone may be wrong, and a gust may pull the voltage down for a moment


class BatteryWatch:
    """One vehicle's. A command, or a pilot, ends the landing that it began."""

    def __init__(self, leave_below_percent: float | None) -> None:
        """None: whatever the battery has, the vehicle stays."""
        self._below_percent = leave_below_percent
        self._since_s: float | None = None  # all samples from then on were below
        self._newest_s = 0.0
        self._percent = 0.0
        self._lands = False

    def hear(self, telemetry: Iterable[Telemetry]) -> None:
        """Once a tick. A charge that the autopilot does not know (-1) is not a low one."""
        for sample in telemetry:
            if not isinstance(sample, SystemSample) or self._below_percent is None:
                continue
            if not 0.0 <= sample.battery_percent < self._below_percent:
                self._since_s = None
            elif self._since_s is None:
                self._since_s = sample.received_s
            self._newest_s, self._percent = sample.received_s, sample.battery_percent

    @property
    def too_low(self) -> str:
        """In words; "" while there is enough."""
        if self._since_s is None or self._newest_s - self._since_s < LOW_FOR_S:
            return ""
        return f"battery at {self._percent:.0f} %, below leave_below_percent {self._below_percent:g}"

    def begin(self) -> None:
        """It is handed over for that."""
        self._lands = True

    def end(self) -> None:
        self._lands = False

    def must_land(self, phase: FlightPhase) -> bool:
        """In hold, for want of battery."""
        self._lands = self._lands and phase in HELD
        return self._lands and phase is FlightPhase.HOLD
