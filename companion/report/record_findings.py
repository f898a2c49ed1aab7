"""Findings of the records: what is missing in them, how late the ticks were, and what the autopilots logged.

Where records are missing, other findings may be missing, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from companion.core.safety.failsafe import limit_of
from companion.link.tick import LATE_S, PERIOD_S
from companion.report.autopilot_logs import MatchedLog, Series
from companion.report.findings import Finding, Severity, finding, runs
from companion.report.flight import Bools, FlightRecords, Floats, VehicleLog
from companion.types.notices import Code

GAP_S = 0.06  # time between two ticks that their lateness does not explain
ENDED_BEFORE_S = 1.0  # before the end of the flight
LEAST_SATELLITES = 6
LARGEST_POSITION_ERROR_M = 3.0
EXCEEDED_APART_S = 5.0
LOGGED_EVERY_S = 2.0  # rows of GPS come a few times a second
LATE_P99_MS = 10.0  # half a period: then the formation flies by old states all the time
TO_COMMAND_P99_MS = 20.0  # one period
FEW_LATE = 0.001  # a smaller share of late ticks is information, unless one was so late that the autopilot took over


def recording_gaps(vehicle: VehicleLog) -> Iterator[Finding]:
    """Dropped records: longer between two ticks than the second one was late. One finding for each start of the agent."""
    ticks, timing = vehicle.ticks, vehicle.timing
    for start in vehicle.starts:
        rows = np.flatnonzero((ticks.time_s >= start.begins_s) & (ticks.time_s <= start.ends_s))
        if rows.size < 2:
            continue
        time_s = ticks.time_s[rows]
        late_s = _late_s(timing.time_s, timing.late_ms, time_s)
        missing_s = np.diff(time_s) - PERIOD_S - late_s[1:]
        gaps = np.flatnonzero(missing_s > GAP_S)
        if gaps.size:
            worst = int(gaps[np.argmax(missing_s[gaps])])
            places = "one place" if gaps.size == 1 else f"{gaps.size} places"
            text = (
                f"records of {missing_s[gaps].sum():.2f} s are missing in {places}, the longest"
                f" {missing_s[worst]:.2f} s at {time_s[worst]:.1f} s"
            )
            lasts_s = float(missing_s[gaps].sum())
            yield finding(Code.RECORDING_GAP, vehicle.vehicle_id, float(time_s[gaps[0]]), text, lasts_s=lasts_s)


def _late_s(timing_s: np.ndarray, late_ms: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """Lateness of each tick (n,), 0 where its timing is not recorded."""
    if not timing_s.size:
        return np.zeros(time_s.size)
    row = np.clip(np.searchsorted(timing_s, time_s - 1e-6), 0, timing_s.size - 1)
    return np.where(np.abs(timing_s[row] - time_s) < 1e-3, late_ms[row] / 1e3, 0.0)


def starts_and_ends(flight: FlightRecords, vehicle: VehicleLog) -> Iterator[Finding]:
    """Files that end early, agents that started again in the air, and recordings that end there."""
    for start in vehicle.starts:
        for problem in start.problems:
            yield finding(Code.RECORDING_TRUNCATED, vehicle.vehicle_id, start.ends_s, problem)
    for before, start in zip(vehicle.starts, vehicle.starts[1:], strict=False):
        if vehicle.in_air_at(np.array([before.ends_s])).any():
            text = (
                f"the agent started again {start.begins_s - before.ends_s:.1f} s after its last record, which was in"
                " the air"
            )
            yield finding(Code.AGENT_RESTARTED, vehicle.vehicle_id, start.begins_s, text)
    last = vehicle.starts[-1]
    if vehicle.in_air_at(np.array([last.ends_s])).any():
        early_s = flight.ends_s - last.ends_s
        text = "the recording ends in the air" + (
            f", {early_s:.1f} s before that of the others" if early_s > ENDED_BEFORE_S else ""
        )
        severity = Severity.CRITICAL if early_s > ENDED_BEFORE_S else Severity.WARNING
        yield finding(Code.RECORDING_ENDS_IN_AIR, vehicle.vehicle_id, last.ends_s, text, severity=severity)


def whole_flight(flight: FlightRecords) -> Iterator[Finding]:
    """Vehicles of the fleet without a recording, clocks that could not be compared, and a flight on the ground only."""
    members = {member.id for member in flight.fleet.vehicles} if flight.fleet else set()
    for vehicle_id in sorted(members - set(flight.ids)):
        text = f"vehicle {vehicle_id} is in the fleet file and has no recording here"
        yield finding(Code.RECORDING_MISSING, vehicle_id, 0.0, text)
    for problem in flight.problems:
        yield finding(Code.RECORDING_UNREADABLE, None, 0.0, problem)
    for vehicle in flight.vehicles:
        if not vehicle.aligned:
            text = (
                "its clock could not be compared with those of the others: its times are by its own date and may be off"
            )
            yield finding(Code.CLOCK_NOT_ALIGNED, vehicle.vehicle_id, 0.0, text)
    if not any(vehicle.in_air().any() for vehicle in flight.vehicles):
        yield finding(Code.NOT_FLOWN, None, 0.0, "no vehicle was in the air")


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


def late_ticks(vehicle: VehicleLog) -> Iterator[Finding]:
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
        yield finding(Code.COMMANDS_SLOW, vehicle.vehicle_id, time_s, text)


def _ticks_late(vehicle: VehicleLog, figures: TimingFigures) -> Finding:
    often = figures.late > FEW_LATE * figures.ticks or figures.lateness.p99_ms > LATE_P99_MS
    worst = figures.lateness.max_ms
    time_s = float(vehicle.timing.time_s[int(np.argmax(vehicle.timing.late_ms == worst))])
    text = (
        f"{figures.late} of {figures.ticks} ticks in the air began more than {1e3 * LATE_S:g} ms late, at most"
        f" {worst:.0f} ms; {figures.missed} periods without a tick; lateness {figures.lateness.p99_ms:.1f} ms (p99)"
    )
    severity = Severity.WARNING if often or worst > 1e3 * limit_of(Code.NO_SETPOINT) else Severity.INFO
    return finding(Code.LOOP_LATE, vehicle.vehicle_id, time_s, text, severity=severity)


def autopilot_findings(matched: MatchedLog, vehicle: VehicleLog) -> Iterator[Finding]:
    """Failsafes, warnings, vibration and GPS."""
    yield from _of_messages(matched, vehicle)
    log, limit = matched.log, matched.log.vibration_limit_m_s2
    missing = Series(log.satellites.time_s, LEAST_SATELLITES - log.satellites.values)
    gps_m = LARGEST_POSITION_ERROR_M
    for series, most, code, text in (
        (log.vibration_m_s2, limit, Code.VIBRATION_HIGH, f"vibration up to {{:.0f}}, limit {limit:g} m/s²"),
        (log.position_error_m, gps_m, Code.GPS_POOR, f"GPS error up to {{:.1f}} m, limit {gps_m:g} m"),
        (missing, 0.0, Code.GPS_POOR, f"fewer than {LEAST_SATELLITES} satellites"),
    ):
        yield from _beyond(vehicle, series.shifted(matched.offset_s), most, code, text)


def _of_messages(matched: MatchedLog, vehicle: VehicleLog) -> Iterator[Finding]:
    """Each text once: autopilots repeat them."""
    known: set[str] = set()
    for message in matched.log.messages:
        time_s = message.time_s + matched.offset_s
        if message.severe and message.text not in known and _is_flown(vehicle, np.array([time_s]))[0]:
            known.add(message.text)
            code = Code.AUTOPILOT_FAILSAFE if message.failsafe else Code.AUTOPILOT_MESSAGE
            yield finding(code, vehicle.vehicle_id, time_s, message.text)


def _beyond(vehicle: VehicleLog, series: Series, limit: float, code: Code, text: str) -> Iterator[Finding]:
    """One finding for each time in the air with values above the limit; `text` may show the largest one."""
    beyond = (series.values > limit) & _is_flown(vehicle, series.time_s)
    for episode in runs(series.time_s, beyond, EXCEEDED_APART_S, LOGGED_EVERY_S):
        largest = float(series.values[episode.first : episode.last + 1].max())
        begins_s, lasts_s = episode.interval.begins_s, episode.held_s
        yield finding(code, vehicle.vehicle_id, begins_s, text.format(largest), lasts_s=lasts_s)


def _is_flown(vehicle: VehicleLog, time_s: Floats) -> Bools:
    """Whether the vehicle was in the air at these times (n,), by its own records."""
    ends_s = vehicle.ticks.time_s[-1:].max(initial=-np.inf)
    return np.asarray(vehicle.in_air_at(time_s) & (time_s <= ends_s), dtype=np.bool_)
