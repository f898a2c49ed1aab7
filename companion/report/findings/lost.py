"""Lost: peers whose packets did not arrive while both vehicles were in the air."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.report.arrays import Bools
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import FlightRecords, VehicleLog
from companion.report.intervals import runs
from companion.types.notices import Code

LOST_S = 0.25  # in three reports in a row
LOST_APART_S = 1.0
REPORT_S = 0.35  # a report counts until the next one, at most for this time


def lost_peers(flight: FlightRecords) -> Iterator[Finding]:
    """One finding for each time a vehicle did not receive another one that was in the air and had been received before."""
    for vehicle in flight.vehicles:
        for other in flight.vehicles:
            if other is not vehicle:
                yield from _lost(vehicle, other)


def _lost(vehicle: VehicleLog, other: VehicleLog) -> Iterator[Finding]:
    statuses = vehicle.statuses
    fresh = np.array([other.vehicle_id in peers for peers in statuses.peers], dtype=np.bool_)
    if not fresh.any():
        return
    known = np.arange(fresh.size) > int(np.argmax(fresh))
    missing = ~fresh & known & statuses.in_air & _in_air_at(other, vehicle)
    for episode in runs(statuses.time_s, missing, LOST_APART_S, REPORT_S):
        if episode.longest_s >= LOST_S:
            text = f"no packets of vehicle {other.vehicle_id} {episode.duration_text}"
            ended_s = _last_record_s(other, episode.interval.ends_s)
            if episode.interval.ends_s - ended_s > REPORT_S:
                text += f"; its records end at {ended_s:.1f} s, in the air"
            yield finding(
                FindingKind.LOST,
                Severity.WARNING,
                Code.PEER_STALE,
                vehicle.vehicle_id,
                episode.interval.begins_s,
                text,
                episode.held_s,
            )


def _in_air_at(other: VehicleLog, vehicle: VehicleLog) -> Bools:
    """Whether the other vehicle is in the air at each report of this one.

    A vehicle whose records end in the air counts as in the air from then on: its agent may have died, not the vehicle.
    """
    time_s, own_s = vehicle.statuses.time_s, other.ticks.time_s
    if not own_s.size:
        return np.zeros(time_s.size, dtype=np.bool_)
    row = np.clip(np.searchsorted(own_s, time_s, side="right") - 1, 0, own_s.size - 1)
    return np.asarray(other.in_air()[row] & (time_s >= own_s[0]), dtype=np.bool_)


def _last_record_s(vehicle: VehicleLog, until_s: float) -> float:
    """Time of its last tick up to a time, of which there is at least one."""
    own_s = vehicle.ticks.time_s
    return float(own_s[np.searchsorted(own_s, until_s, side="right") - 1])
