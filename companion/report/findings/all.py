"""All findings of a flight."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from companion.report.autopilot.files import NO_LOGS, AutopilotLogs
from companion.report.distances import PairDistance
from companion.report.finding import Finding, in_order
from companion.report.findings.autopilot import autopilot_findings
from companion.report.findings.closeness import too_close
from companion.report.findings.commands import refused_commands
from companion.report.findings.failsafes import (
    disarmed_in_air,
    failsafe_events,
    raised_flags,
    settings_of,
    streams_ended,
)
from companion.report.findings.lost import lost_peers
from companion.report.findings.recording import recording_gaps, starts_and_ends, whole_flight
from companion.report.findings.timing import late
from companion.report.flight import FlightRecords


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
        yield from late(vehicle)
        yield from refused_commands(vehicle)
        yield from recording_gaps(vehicle)
        yield from starts_and_ends(flight, vehicle)
    yield from logs.left_out
    vehicles = {vehicle.vehicle_id: vehicle for vehicle in flight.vehicles}
    for matched in logs.matched:
        yield from autopilot_findings(matched, vehicles[matched.vehicle_id])
