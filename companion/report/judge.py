"""A recorded flight with all that follows from its records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from companion.report.arrays import Floats
from companion.report.autopilot.files import NO_LOGS, AutopilotLogs
from companion.report.distances import PairDistance, grid_of, pair_distances
from companion.report.errors import errors_to_slot_m
from companion.report.findings.all import all_findings
from companion.report.flight import FlightRecords
from companion.report.summary import FlightSummary, summary_of


@dataclass(frozen=True, slots=True)
class Judged:
    """Pairs with the nearest first; errors to the slot by vehicle, per tick."""

    flight: FlightRecords
    pairs: Sequence[PairDistance]
    errors_m: Mapping[int, Floats]
    summary: FlightSummary
    logs: AutopilotLogs


def judged(flight: FlightRecords, logs: AutopilotLogs = NO_LOGS) -> Judged:
    """Distances, errors and findings, from all records."""
    pairs = pair_distances(flight, grid_of(flight))
    errors_m = errors_to_slot_m(flight)
    findings = all_findings(flight, pairs, logs)
    return Judged(flight, pairs, errors_m, summary_of(flight, pairs, errors_m, findings), logs)
