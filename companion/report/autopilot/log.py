"""What the report takes from the log of an autopilot, whatever its make. Times are seconds of the autopilot's clock."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from companion.report.arrays import Floats
from companion.types.errors import CompanionError


class LogError(CompanionError):
    """A log that cannot be used. str() is the reason."""


@dataclass(frozen=True, slots=True)
class Series:
    """Values (n,) at times (n,); empty where the log has none."""

    time_s: Floats = field(default_factory=lambda: np.empty(0))
    values: Floats = field(default_factory=lambda: np.empty(0))

    def shifted(self, by_s: float) -> Series:
        return Series(self.time_s + by_s, self.values)


@dataclass(frozen=True, slots=True)
class LogMessage:
    """`failsafe`: the autopilot acted by itself. `severe`: a warning or worse."""

    time_s: float
    text: str
    failsafe: bool = False
    severe: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AutopilotLog:
    """`velocity_enu_m_s` is (n, 3) at the times of `altitude_m`. Vibration beyond `vibration_limit_m_s2` is a finding."""

    name: str
    make: str
    altitude_m: Series
    velocity_enu_m_s: Floats
    voltage_v: Series = Series()
    vibration_m_s2: Series = Series()
    vibration_limit_m_s2: float
    satellites: Series = Series()
    position_error_m: Series = Series()
    messages: tuple[LogMessage, ...] = ()
