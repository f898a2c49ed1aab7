"""The files of one flight's folder: summary.json and the figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from companion.assembly import law_of
from companion.config.reference import TargetReference
from companion.core.reference.trajectories import ReferenceTrajectory
from companion.types.commands import CommandName
from sitl.flight.scenario import Scenario, reference_of
from sitl.flight.watch import FlightWatch
from sitl.report.metrics import (
    Flight,
    FormationFigures,
    Tracks,
    TrackSource,
    formation_figures,
    neighbouring_pairs,
    pair_name,
    smallest_distance_m,
)
from sitl.report.summary import Summary, Tick, VehicleSummary, write_json
from sitl.report.tracking import Tracking, tracking


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
    *,
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
        scenario,
        name,
        watch,
        figures,
        tracked,
        smallest_m,
        failure=failure,
        flight_s=flight_s,
        real_time_factor=real_time_factor,
        source=source,
    )
    write_json(folder / "summary.json", summary)
    if flight:
        from sitl.report.plan_view import save_plan_view  # matplotlib is slow to import
        from sitl.report.plots import save_figure_5, save_figure_6

        save_figure_5(folder / "figure_5.png", flight, name)
        save_figure_6(folder / "figure_6.png", flight, name)
        save_plan_view(folder / "from_above.png", flight, watch, name, scenario.fleet.airspace)
    return FlightResult(summary, flight)


def summarize(
    scenario: Scenario,
    name: str,
    watch: FlightWatch,
    figures: FormationFigures | None,
    tracked: Tracking | None,
    smallest_distance_m: float | None,
    *,
    failure: str | None,
    flight_s: float,
    real_time_factor: float | None = None,
    source: TrackSource = "true",
) -> Summary:
    """`figures`, `tracked` and `smallest_distance_m` are of the tracks from `source`; the rest is from the reports."""
    fleet, stand_in = scenario.fleet, scenario.stand_in
    sensors = stand_in.sensors if isinstance(stand_in.sensors, str) else "as given"
    slots_enu_m = {member.id: member.slot_enu_m for member in fleet.vehicles}
    weighting = law_of(fleet.law).weighting
    return Summary(
        scenario=name,
        law=fleet.law.name,
        exponent=weighting.exponent,
        weight_ratio=weighting.ratio,
        tracks=source,
        sensors=sensors if source == "true" else None,
        seed=stand_in.seed if source == "true" else None,
        failure=failure,
        flight_s=round(flight_s, 1),
        real_time_factor=None if real_time_factor is None else round(real_time_factor, 1),
        duration_s=round(figures.duration_s, 3) if figures else None,
        pairs=[pair_name(pair) for pair in neighbouring_pairs(slots_enu_m)],
        wanted_distance_m=_rounded(figures.wanted_distance_m) if figures else None,
        max_distance_m=_rounded(figures.max_distance_m) if figures else None,
        min_distance_m=_rounded(figures.min_distance_m) if figures else None,
        final_distance_m=_rounded(figures.final_distance_m) if figures else None,
        reference_moves=figures.reference_moves if figures else None,
        settle_s=round(figures.settle_s, 2) if figures and figures.settle_s is not None else None,
        first_within_s=round(figures.first_within_s, 2) if figures and figures.first_within_s is not None else None,
        least_error_m=round(figures.least_error_m, 4) if figures else None,
        final_error_m=round(figures.final_error_m, 4) if figures else None,
        overload=watch.overload(),
        smallest_distance_m=None if smallest_distance_m is None else round(smallest_distance_m, 4),
        vehicles=[
            _vehicle(member.id, member.role, watch, figures, tracked)
            for member in sorted(fleet.vehicles, key=lambda member: member.id)
        ],
        commands=watch.commands,
        events=watch.events,
    )


def _vehicle(
    vehicle_id: int, role: str, watch: FlightWatch, figures: FormationFigures | None, tracked: Tracking | None
) -> VehicleSummary:
    timing, step_deg = watch.timing.get(vehicle_id), watch.largest_step_deg.get(vehicle_id)
    tick = timing and Tick(rate_hz=timing.rate_hz, ticks=timing.ticks, missed=timing.missed, late_us=timing.late_us)
    return VehicleSummary(
        id=vehicle_id,
        role=role,
        tick=tick or None,
        telemetry_to_command_us=timing.telemetry_to_command_us if timing else None,
        cpu_percent=timing.cpu_percent if timing else None,
        rss_mb=timing.rss_mb if timing else None,
        final_error_m=round(figures.final_error_of_vehicle_m[vehicle_id], 4) if figures else None,
        tracking_error_m=_metres(tracked.to_reference_m[vehicle_id] if tracked else None),
        behind_leader_m=_metres(tracked.to_leader_m[vehicle_id] if tracked else None),
        largest_step_deg=None if step_deg is None else round(step_deg, 2),
        rejected=watch.rejected()[vehicle_id],
    )


def _metres(value_m: float | None) -> float | None:
    return None if value_m is None else round(value_m, 4)


def _rounded(values_m: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value_m, 4) for name, value_m in values_m.items()}


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
