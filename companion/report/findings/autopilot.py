"""What the logs of the autopilots show while the vehicle was in the air."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.report.arrays import Bools, Floats
from companion.report.autopilot.log import LogMessage, Series
from companion.report.autopilot.match import MatchedLog
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import VehicleLog
from companion.report.intervals import runs
from companion.types.notices import Code

LEAST_SATELLITES = 6
LARGEST_POSITION_ERROR_M = 3.0
EXCEEDED_APART_S = 5.0
HELD_S = 2.0  # rows of GPS come a few times a second


def autopilot_findings(matched: MatchedLog, vehicle: VehicleLog) -> Iterator[Finding]:
    """Failsafes, warnings, vibration and GPS."""
    yield from _of_messages(matched, vehicle)
    log, by_s = matched.log, matched.offset_s
    limit = log.vibration_limit_m_s2
    yield from _beyond(
        vehicle,
        log.vibration_m_s2.shifted(by_s),
        limit,
        Code.VIBRATION_HIGH,
        f"vibration up to {{:.0f}}, limit {limit:g} m/s²",
    )
    yield from _beyond(
        vehicle,
        log.position_error_m.shifted(by_s),
        LARGEST_POSITION_ERROR_M,
        Code.GPS_POOR,
        f"GPS error up to {{:.1f}} m, limit {LARGEST_POSITION_ERROR_M:g} m",
    )
    satellites = log.satellites.shifted(by_s)
    yield from _beyond(
        vehicle,
        Series(satellites.time_s, LEAST_SATELLITES - satellites.values),
        0.0,
        Code.GPS_POOR,
        f"fewer than {LEAST_SATELLITES} satellites",
    )


def _of_messages(matched: MatchedLog, vehicle: VehicleLog) -> Iterator[Finding]:
    """Each text once: autopilots repeat them."""
    known: set[str] = set()
    for message in matched.log.messages:
        time_s = message.time_s + matched.offset_s
        if message.severe and message.text not in known and in_air_at(vehicle, np.array([time_s]))[0]:
            known.add(message.text)
            yield _of_message(message, vehicle.vehicle_id, time_s)


def _of_message(message: LogMessage, vehicle_id: int, time_s: float) -> Finding:
    if message.failsafe:
        return finding(
            FindingKind.AUTOPILOT, Severity.CRITICAL, Code.AUTOPILOT_FAILSAFE, vehicle_id, time_s, message.text
        )
    return finding(FindingKind.AUTOPILOT, Severity.WARNING, Code.AUTOPILOT_MESSAGE, vehicle_id, time_s, message.text)


def _beyond(vehicle: VehicleLog, series: Series, limit: float, code: Code, text: str) -> Iterator[Finding]:
    """One finding for each time in the air with values above the limit; `text` may show the largest one."""
    beyond = (series.values > limit) & in_air_at(vehicle, series.time_s)
    for episode in runs(series.time_s, beyond, EXCEEDED_APART_S, HELD_S):
        largest = float(series.values[episode.first : episode.last + 1].max())
        yield finding(
            FindingKind.AUTOPILOT,
            Severity.WARNING,
            code,
            vehicle.vehicle_id,
            episode.interval.begins_s,
            text.format(largest),
            episode.held_s,
        )


def in_air_at(vehicle: VehicleLog, time_s: Floats) -> Bools:
    """Whether the vehicle was in the air at these times (n,)."""
    own_s = vehicle.ticks.time_s
    if not own_s.size:
        return np.zeros(time_s.size, dtype=np.bool_)
    row = np.clip(np.searchsorted(own_s, time_s, side="right") - 1, 0, own_s.size - 1)
    inside = (time_s >= own_s[0]) & (time_s <= own_s[-1])
    return np.asarray(vehicle.in_air()[row] & inside, dtype=np.bool_)
