"""What the audit looks at, gathered from telemetry: rates, battery, the autopilot's own checks. Time is an argument."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.types import (
    AttitudeSample,
    LandedSample,
    ModeSample,
    PositionSample,
    SystemSample,
    Telemetry,
    TextSample,
)

WINDOW_S = 2.0  # over which rates are counted
NAMES: Mapping[type[Telemetry], str] = {
    PositionSample: "positions",
    AttitudeSample: "attitudes",
    ModeSample: "modes",
    LandedSample: "landed states",
}
WARNING = 4  # MAV_SEVERITY


class Survey:
    """Newest of what came, and how often. Rates are those of the last whole window, None before there was one."""

    def __init__(self) -> None:
        self.rates_hz: Mapping[str, float] | None = None
        self.battery_percent: float | None = None
        self.may_arm: bool | None = None
        self.last_warning = ""  # of the autopilot's own texts
        self._counts: dict[type[Telemetry], int] = {}
        self._window_since_s: float | None = None

    def hear(self, now_s: float, telemetry: Sequence[Telemetry]) -> None:
        """Everything that came since the last call; what comes with the first is older than the window, and not counted."""
        if self._window_since_s is None:
            self._window_since_s = now_s
            telemetry = ()
        counts = self._counts
        for sample in telemetry:
            kind = type(sample)
            counts[kind] = counts.get(kind, 0) + 1
            if isinstance(sample, SystemSample):
                self.battery_percent, self.may_arm = sample.battery_percent, sample.may_arm
            elif isinstance(sample, TextSample) and sample.severity <= WARNING:
                self.last_warning = sample.text
        elapsed_s = now_s - self._window_since_s
        if elapsed_s >= WINDOW_S:
            self.rates_hz = {name: counts.get(kind, 0) / elapsed_s for kind, name in NAMES.items()}
            counts.clear()
            self._window_since_s = now_s

    @property
    def checks_lack(self) -> str | None:
        """What the autopilot's own checks before arming lack; "" where nothing, None where it did not tell."""
        if self.may_arm is None:
            return None
        return "" if self.may_arm else self.last_warning or "its checks before arming do not pass"
