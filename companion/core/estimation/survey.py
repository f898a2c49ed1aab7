"""Facts for the vehicle audit, collected from telemetry: message rates, battery and the autopilot's preflight checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from companion.types.telemetry import (
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
    """Newest values and message rates. Rates are of the last complete window; None before the first."""

    def __init__(self) -> None:
        self.rates_hz: Mapping[str, float] | None = None
        self.battery_percent: float | None = None
        self.may_arm: bool | None = None
        self.last_warning = ""  # newest STATUSTEXT of severity WARNING or worse
        self._counts: dict[type[Telemetry], int] = dict.fromkeys(NAMES, 0)
        self._window_since_s: float | None = None

    def update(self, now_s: float, telemetry: Sequence[Telemetry]) -> bool:
        """Add the telemetry since the last call; return whether what is found has changed.

        The telemetry of the first call is older than the window and is not counted.
        """
        changed = False
        if self._window_since_s is None:
            self._window_since_s = now_s
            telemetry = ()
        counts = self._counts
        for sample in telemetry:
            kind = type(sample)
            if kind in counts:
                counts[kind] += 1
            elif isinstance(sample, SystemSample):
                changed |= (self.battery_percent, self.may_arm) != (sample.battery_percent, sample.may_arm)
                self.battery_percent, self.may_arm = sample.battery_percent, sample.may_arm
            elif isinstance(sample, TextSample) and sample.severity <= WARNING:
                changed |= self.last_warning != sample.text
                self.last_warning = sample.text
        elapsed_s = now_s - self._window_since_s
        if elapsed_s >= WINDOW_S:
            rates_hz = {name: counts[kind] / elapsed_s for kind, name in NAMES.items()}
            changed |= rates_hz != self.rates_hz
            self.rates_hz, self._counts = rates_hz, dict.fromkeys(NAMES, 0)
            self._window_since_s = now_s
        return changed

    @property
    def failing_checks(self) -> str | None:
        """Why the autopilot's preflight checks fail; "" where they pass, None where it has not reported them."""
        if self.may_arm is None:
            return None
        return "" if self.may_arm else self.last_warning or "the autopilot's preflight checks do not pass"
