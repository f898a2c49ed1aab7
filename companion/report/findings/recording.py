"""What is missing in the recordings themselves: then other findings may be missing, too."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from companion.link.tick import PERIOD_S
from companion.report.finding import Finding, FindingKind, Severity, finding
from companion.report.flight import FlightRecords, VehicleLog
from companion.types.notices import Code

GAP_S = 0.06  # time between two ticks that their lateness does not explain
ENDED_BEFORE_S = 1.0  # before the end of the flight


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
            yield finding(
                FindingKind.RECORDING,
                Severity.WARNING,
                Code.RECORDING_GAP,
                vehicle.vehicle_id,
                float(time_s[gaps[0]]),
                text,
                float(missing_s[gaps].sum()),
            )


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
            yield finding(
                FindingKind.RECORDING,
                Severity.WARNING,
                Code.RECORDING_TRUNCATED,
                vehicle.vehicle_id,
                start.ends_s,
                problem,
            )
    for before, start in zip(vehicle.starts, vehicle.starts[1:], strict=False):
        if _in_air_at(vehicle, before.ends_s):
            text = (
                f"the agent started again {start.begins_s - before.ends_s:.1f} s after its last record, which was in"
                " the air"
            )
            yield finding(
                FindingKind.FAILSAFE, Severity.CRITICAL, Code.AGENT_RESTARTED, vehicle.vehicle_id, start.begins_s, text
            )
    last = vehicle.starts[-1]
    if _in_air_at(vehicle, last.ends_s):
        early_s = flight.ends_s - last.ends_s
        text = "the recording ends in the air" + (
            f", {early_s:.1f} s before that of the others" if early_s > ENDED_BEFORE_S else ""
        )
        yield finding(
            FindingKind.RECORDING,
            Severity.CRITICAL if early_s > ENDED_BEFORE_S else Severity.WARNING,
            Code.RECORDING_ENDS_IN_AIR,
            vehicle.vehicle_id,
            last.ends_s,
            text,
        )


def _in_air_at(vehicle: VehicleLog, time_s: float) -> bool:
    row = int(np.searchsorted(vehicle.ticks.time_s, time_s, side="right")) - 1
    return row >= 0 and bool(vehicle.in_air()[row])


def whole_flight(flight: FlightRecords) -> Iterator[Finding]:
    """Vehicles of the fleet without a recording, clocks that could not be compared, and a flight on the ground only."""
    members = {member.id for member in flight.fleet.vehicles} if flight.fleet else set()
    for vehicle_id in sorted(members - set(flight.ids)):
        text = f"vehicle {vehicle_id} is in the fleet file and has no recording here"
        yield finding(FindingKind.RECORDING, Severity.WARNING, Code.RECORDING_MISSING, vehicle_id, 0.0, text)
    for problem in flight.problems:
        yield finding(FindingKind.RECORDING, Severity.WARNING, Code.RECORDING_UNREADABLE, None, 0.0, problem)
    for vehicle in flight.vehicles:
        if not vehicle.aligned:
            text = (
                "its clock could not be compared with those of the others: its times are by its own date and may be off"
            )
            yield finding(
                FindingKind.RECORDING, Severity.WARNING, Code.CLOCK_NOT_ALIGNED, vehicle.vehicle_id, 0.0, text
            )
    if not any(vehicle.in_air().any() for vehicle in flight.vehicles):
        yield finding(FindingKind.RECORDING, Severity.INFO, Code.NOT_FLOWN, None, 0.0, "no vehicle was in the air")
