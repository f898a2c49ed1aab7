"""Late: ticks of the agent and the way from telemetry to command, while the vehicle was in the air."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.safety.failsafe import SILENT_TOO_LONG_S
from companion.link.tick import LATE_S, PERIOD_S
from companion.report.arrays import Floats
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import VehicleLog
from companion.types.notices import Code

LATE_P99_MS = 10.0  # half a period: then the formation flies by old states all the time
TO_COMMAND_P99_MS = 20.0  # one period
FEW_LATE = 0.001  # a smaller share of late ticks is information, unless one was so late that the autopilot took over


@dataclass(frozen=True, slots=True)
class TimePercentiles:
    """Of measured times, milliseconds; NaN without any."""

    p50_ms: float
    p99_ms: float
    max_ms: float


@dataclass(frozen=True, slots=True)
class TimingFigures:
    """Timing in the air. `missed`: periods without a tick, `late`: ticks that began more than LATE_S late."""

    ticks: int
    missed: int
    late: int
    lateness: TimePercentiles
    to_command: TimePercentiles


def percentiles(values_ms: Floats) -> TimePercentiles:
    """Of the known values (n,)."""
    known = values_ms[~np.isnan(values_ms)]
    if not known.size:
        return TimePercentiles(np.nan, np.nan, np.nan)
    p50, p99 = np.percentile(known, (50, 99))
    return TimePercentiles(float(p50), float(p99), float(known.max()))


def timing_figures(vehicle: VehicleLog) -> TimingFigures:
    """Of the ticks in the air. Gaps of the recording are no missed ticks: a late tick records how late it was."""
    timing = vehicle.timing
    late_ms, to_command_ms = in_air_ms(vehicle)
    return TimingFigures(
        ticks=int(late_ms.size),
        missed=int(np.sum((late_ms / (1e3 * PERIOD_S) + 1e-6).astype(np.int64))) if late_ms.size else 0,
        late=int(np.sum(late_ms > 1e3 * LATE_S)) if timing.time_s.size else 0,
        lateness=percentiles(late_ms),
        to_command=percentiles(to_command_ms),
    )


def in_air_ms(vehicle: VehicleLog) -> tuple[Floats, Floats]:
    """(lateness, telemetry to command) of the ticks in the air."""
    timing, ticks = vehicle.timing, vehicle.ticks
    if not timing.time_s.size or not ticks.time_s.size:
        return np.empty(0), np.empty(0)
    row = np.clip(np.searchsorted(ticks.time_s, timing.time_s - 1e-6), 0, ticks.time_s.size - 1)
    in_air = vehicle.in_air()[row]
    return timing.late_ms[in_air], timing.to_command_ms[in_air]


def late(vehicle: VehicleLog) -> Iterator[Finding]:
    """At most one finding for the ticks and one for the way from telemetry to command."""
    figures = timing_figures(vehicle)
    if figures.late or figures.lateness.p99_ms > LATE_P99_MS:
        yield _ticks_late(vehicle, figures)
    if figures.to_command.p99_ms > TO_COMMAND_P99_MS:
        text = (
            f"from telemetry to command {figures.to_command.p99_ms:.1f} ms (p99), at most"
            f" {figures.to_command.max_ms:.1f} ms; limit {TO_COMMAND_P99_MS:g} ms (p99)"
        )
        time_s = float(vehicle.timing.time_s[int(np.nanargmax(vehicle.timing.to_command_ms))])
        yield finding(FindingKind.LATE, Severity.WARNING, Code.COMMANDS_SLOW, vehicle.vehicle_id, time_s, text)


def _ticks_late(vehicle: VehicleLog, figures: TimingFigures) -> Finding:
    often = figures.late > FEW_LATE * figures.ticks or figures.lateness.p99_ms > LATE_P99_MS
    worst = figures.lateness.max_ms
    time_s = float(vehicle.timing.time_s[int(np.argmax(vehicle.timing.late_ms == worst))])
    text = (
        f"{figures.late} of {figures.ticks} ticks in the air began more than {1e3 * LATE_S:g} ms late, at most"
        f" {worst:.0f} ms; {figures.missed} periods without a tick; lateness {figures.lateness.p99_ms:.1f} ms (p99)"
    )
    severity = Severity.WARNING if often or worst > 1e3 * SILENT_TOO_LONG_S else Severity.INFO
    return finding(FindingKind.LATE, severity, Code.LOOP_LATE, vehicle.vehicle_id, time_s, text)
