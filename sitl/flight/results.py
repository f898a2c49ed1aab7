"""The files of one flight's folder: summary.json and the figures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from companion.config.reference import TargetReference
from companion.core.reference.trajectories import ReferenceTrajectory
from companion.types.commands import CommandName
from sitl.flight.scenario import Scenario, reference_of
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import Flight, Tracks, TrackSource, formation_figures, neighbouring_pairs, smallest_distance_m
from sitl.report.summary import Summary, summarize, write_json
from sitl.report.tracking import tracking


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One flight: its figures, and what they are drawn from (None where no formation was flown)."""

    summary: Summary
    flight: Flight | None


def write_results(
    scenario: Scenario,
    name: str,
    folder: Path,
    watch: FlightWatch,
    tracks: Tracks | None,
    failure: str | None,
    flight_s: float,
    real_time_factor: float | None = None,
    source: TrackSource = "true",
) -> FlightResult:
    """summary.json and, where a formation was flown, its figures. `tracks` is None where none are known."""
    flight = _flight(scenario, watch, tracks, source) if tracks else None
    figures = formation_figures(flight.tracks, flight.slots, flight.reference, flight.formation) if flight else None
    tracked = (
        tracking(flight.tracks, flight.slots, flight.reference, flight.formation, watch.leads()) if flight else None
    )
    smallest_m = smallest_distance_m(tracks) if tracks else None
    summary = summarize(
        scenario, name, watch, figures, tracked, smallest_m, failure, flight_s, real_time_factor, source
    )
    write_json(folder / "summary.json", summary)
    if flight:
        from sitl.report.plan_view import save_plan_view  # matplotlib is slow to import
        from sitl.report.plots import save_figure_5, save_figure_6

        save_figure_5(folder / "figure_5.png", flight, name)
        save_figure_6(folder / "figure_6.png", flight, name)
        save_plan_view(folder / "from_above.png", flight, watch, name, scenario.fleet.airspace)
    return FlightResult(summary, flight)


def reference_flown(scenario: Scenario, watch: FlightWatch) -> ReferenceTrajectory:
    """The configured reference, or the reported one where commands or a target change it."""
    changes = any(step.command is CommandName.REFERENCE for step in scenario.timeline)
    varies = changes or isinstance(scenario.reference, TargetReference)
    return watch.reported_reference() if varies and len(watch.reference) > 1 else reference_of(scenario)


def _flight(scenario: Scenario, watch: FlightWatch, tracks: Tracks, source: TrackSource) -> Flight | None:
    if watch.formation is None:
        return None
    pairs = neighbouring_pairs({member.id: member.slot_enu_m for member in scenario.fleet.vehicles})
    reference = reference_flown(scenario, watch)
    return Flight(scenario.fleet.law.name, tracks, watch.slots(), pairs, reference, watch.formation, source)
