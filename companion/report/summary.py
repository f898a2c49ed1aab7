"""Judges a flight: all findings, its key figures, and what `--json` prints."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from msgspec import Struct

from companion import __version__
from companion.report.autopilot_logs import NO_LOGS, AutopilotLogs
from companion.report.distances import PairDistance, errors_to_slot_m, grid_of, in_formation, pair_distances
from companion.report.findings import Finding, Severity, in_order
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.report.flight_findings import (
    disarmed_in_air,
    failsafe_events,
    lost_peers,
    raised_flags,
    refused_commands,
    settings_of,
    streams_ended,
    too_close,
)
from companion.report.record_findings import (
    autopilot_findings,
    late_ticks,
    recording_gaps,
    starts_and_ends,
    timing_figures,
    whole_flight,
)

SUMMARY_VERSION = 1


class VehicleFigures(Struct, frozen=True, kw_only=True):
    """Of one vehicle. None stands for what is not recorded. Errors are those in formation, timing that in the air."""

    vehicle_id: int
    starts: int
    recorded_s: float
    in_air_s: float
    in_formation_s: float
    error_mean_m: float | None
    error_max_m: float | None
    ticks: int
    missed: int
    late_p50_ms: float | None
    late_p99_ms: float | None
    late_max_ms: float | None
    telemetry_to_command_p50_ms: float | None
    telemetry_to_command_p99_ms: float | None
    telemetry_to_command_max_ms: float | None
    battery_begin_percent: float | None
    battery_end_percent: float | None
    commands: int
    refused: int


class SmallestSeparation(Struct, frozen=True):
    """The smallest distance in the air, in the metric of `separation_m`."""

    pair: tuple[int, int]
    distance_m: float
    time_s: float


class FlightSummary(Struct, frozen=True, kw_only=True):
    """What `companion report --json` prints. `begin_unix_s` is the Unix time of 0 s; None without a date."""

    version: int = SUMMARY_VERSION
    software: str = __version__
    fleet: str
    begin_unix_s: float | None
    lasts_s: float
    vehicles: tuple[VehicleFigures, ...]
    separation_m: float | None
    smallest_separation: SmallestSeparation | None
    findings: tuple[Finding, ...]

    def count(self, severity: Severity) -> int:
        return sum(one.severity is severity for one in self.findings)


def summary_of(
    flight: FlightRecords,
    pairs: Sequence[PairDistance],
    errors_m: Mapping[int, Floats],
    findings: Sequence[Finding],
) -> FlightSummary:
    """The figures of the whole flight."""
    flown = [pair for pair in pairs if pair.judged.any()]
    return FlightSummary(
        fleet=flight.fleet_name,
        begin_unix_s=round(flight.begin_unix_s, 3) if flight.has_date else None,
        lasts_s=round(flight.ends_s, 3),
        vehicles=tuple(vehicle_figures(vehicle, errors_m[vehicle.vehicle_id]) for vehicle in flight.vehicles),
        separation_m=flight.separation_m,
        smallest_separation=_smallest(flown[0]) if flown else None,
        findings=tuple(findings),
    )


def _smallest(pair: PairDistance) -> SmallestSeparation:
    return SmallestSeparation(pair.pair, round(pair.smallest_m, 3), round(pair.smallest_at_s, 3))


def vehicle_figures(vehicle: VehicleLog, error_m: Floats) -> VehicleFigures:
    """`error_m`: error to the slot per tick (n,)."""
    formation = in_formation(vehicle)
    errors_m = error_m[formation & ~np.isnan(error_m)]
    timing = timing_figures(vehicle)
    charge = vehicle.ticks.battery_percent[~np.isnan(vehicle.ticks.battery_percent)]
    return VehicleFigures(
        vehicle_id=vehicle.vehicle_id,
        starts=len(vehicle.starts),
        recorded_s=round(sum(start.ends_s - start.begins_s for start in vehicle.starts), 1),
        in_air_s=_lasts_s(vehicle, vehicle.in_air()),
        in_formation_s=_lasts_s(vehicle, formation),
        error_mean_m=_known(errors_m.mean(), 3) if errors_m.size else None,
        error_max_m=_known(errors_m.max(), 3) if errors_m.size else None,
        ticks=timing.ticks,
        missed=timing.missed,
        late_p50_ms=_known(timing.lateness.p50_ms),
        late_p99_ms=_known(timing.lateness.p99_ms),
        late_max_ms=_known(timing.lateness.max_ms),
        telemetry_to_command_p50_ms=_known(timing.to_command.p50_ms),
        telemetry_to_command_p99_ms=_known(timing.to_command.p99_ms),
        telemetry_to_command_max_ms=_known(timing.to_command.max_ms),
        battery_begin_percent=_known(charge[0], 1) if charge.size else None,
        battery_end_percent=_known(charge[-1], 1) if charge.size else None,
        commands=len(vehicle.commands),
        refused=sum(command.answered_s is not None and not command.accepted for command in vehicle.commands),
    )


def _lasts_s(vehicle: VehicleLog, holds: np.ndarray) -> float:
    """How long a condition of the ticks held, without the gaps of the recording."""
    steps_s = np.minimum(np.diff(vehicle.ticks.time_s, append=vehicle.ticks.time_s[-1:]), 0.1)
    return round(float(steps_s[holds].sum()), 1)


def _known(value: float, digits: int = 2) -> float | None:
    return None if math.isnan(value) else round(float(value), digits)


@dataclass(frozen=True, slots=True)
class JudgedFlight:
    """Pairs with the nearest first; errors to the slot by vehicle, per tick."""

    flight: FlightRecords
    pairs: Sequence[PairDistance]
    errors_m: Mapping[int, Floats]
    summary: FlightSummary
    logs: AutopilotLogs


def judge(flight: FlightRecords, logs: AutopilotLogs = NO_LOGS) -> JudgedFlight:
    """Distances, errors and findings, from all records."""
    pairs = pair_distances(flight, grid_of(flight))
    errors_m = errors_to_slot_m(flight)
    findings = all_findings(flight, pairs, logs)
    return JudgedFlight(flight, pairs, errors_m, summary_of(flight, pairs, errors_m, findings), logs)


def all_findings(
    flight: FlightRecords, pairs: Sequence[PairDistance], logs: AutopilotLogs = NO_LOGS
) -> tuple[Finding, ...]:
    """In the order of the page: the most severe first."""
    return in_order(_found(flight, pairs, logs))


def _found(flight: FlightRecords, pairs: Sequence[PairDistance], logs: AutopilotLogs) -> Iterator[Finding]:
    settings = settings_of(flight.fleet)
    yield from whole_flight(flight)
    yield from too_close(pairs, flight.separation_m)
    yield from lost_peers(flight)
    for vehicle in flight.vehicles:
        yield from raised_flags(vehicle, settings)
        yield from failsafe_events(vehicle)
        yield from streams_ended(vehicle)
        yield from disarmed_in_air(vehicle)
        yield from late_ticks(vehicle)
        yield from refused_commands(vehicle)
        yield from recording_gaps(vehicle)
        yield from starts_and_ends(flight, vehicle)
    yield from logs.left_out
    vehicles = {vehicle.vehicle_id: vehicle for vehicle in flight.vehicles}
    for matched in logs.matched:
        yield from autopilot_findings(matched, vehicles[matched.vehicle_id])
