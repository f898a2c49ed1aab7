"""From a scenario file to a folder of results, under one law or several: check, flights, figures.

How a flight is flown is an argument (`run_flights`); `run_virtual` is `sitl run`, sitl/flight/fly.py has that of `sitl fly`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from companion.analysis.interaction import couple, mode_eigenvalues, mode_figures
from companion.analysis.margins import delay_margin_with_lag_s, string_gains
from companion.analysis.response import Graph, LinearModel, reached_from
from companion.assembly import law_of
from companion.config.file import ConfigError
from companion.config.fleet import LawName
from companion.config.planned_flight import neighbour_graph
from companion.config.reference import TargetReference
from companion.core.consensus.law import FormationLaw
from companion.core.reference.blend import ReferenceTrajectory
from companion.tools.analysis_report import BADLY_DAMPED, GROWS, SMALL_DELAY_MARGIN_S
from companion.types.commands import CommandName
from companion.types.errors import EXIT_DONE, EXIT_FAILED, UnusableError
from companion.types.flight import Role
from companion.types.notices import Code, Notice
from sitl.flight.files import truth_path, write_scenario
from sitl.flight.scenario import Scenario, load_scenario, reference_of, with_law
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.flight.watch import FlightWatch
from sitl.report.compare import compare, in_a_table, write_comparison
from sitl.report.folder import open_folder
from sitl.report.metrics import (
    FormationFigures,
    FormationFlight,
    Tracking,
    Tracks,
    TrackSource,
    formation_figures,
    neighbouring_pairs,
    pair_name,
    smallest_distance_m,
    tracking,
)
from sitl.report.progress import FlightProgress
from sitl.report.summary import RunSummary, TickFigures, VehicleSummary, in_words, write_json
from sitl.stopping import StopRequest

MODEL = LinearModel()


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightOptions:
    """Options of `sitl run`, `sitl fly` and `sitl fleet`.

    `others` are the laws to compare with, None without --compare. `anyway` flies an unstable formation, too. `record`: agents
    in virtual time leave recordings; those of real processes always do. Real processes choose `port_offset` themselves where it
    is None; `external` is the file of their external autopilots.
    """

    scenario: Path
    overrides: Sequence[str] = ()
    others: Sequence[LawName] | None = None
    out: Path | None = None
    quiet: bool = False
    anyway: bool = False
    record: bool = False
    port_offset: int | None = None
    external: Path | None = None


class DivergesError(UnusableError):
    """The formation cannot converge. str() is one line."""


def check_convergence(scenario: Scenario) -> list[Notice]:
    """Warnings about the formation under the scenario's law. Raises DivergesError for one that cannot converge."""
    fleet, law = scenario.fleet, law_of(scenario.fleet.law)
    height_m = fleet.takeoff_height_m
    graph = neighbour_graph(
        fleet.neighbours, {i: (x, y, z + height_m) for i, (x, y, z) in scenario.starts_enu_m.items()}
    )
    leaders = [member.id for member in fleet.vehicles if member.role is Role.LEADER]
    if unreached := sorted(set(graph) - reached_from(graph, leaders)):
        ids = ", ".join(map(str, unreached))
        text = f"no path leads from a leader to vehicle {ids}; add an edge, more range, or a leader among them"
        raise _diverges(Notice(Code.NO_PATH_TO_LEADER, text))
    margin_s = delay_margin_with_lag_s(couple(graph, leaders, law), MODEL)
    if margin_s <= MODEL.delay_s:
        text = (
            f"{fleet.law.name} is unstable from a loop delay of {margin_s:.3f} s on, and {MODEL.delay_s:g} s is usual;"
            " change the gains or the law"
        )
        raise _diverges(Notice(Code.FORMATION_UNSTABLE, text))
    return _warnings(graph, leaders, law, margin_s)


def _diverges(notice: Notice) -> DivergesError:
    return DivergesError(f"{notice}; `companion analyze` shows more, and --anyway flies it")


def _warnings(graph: Graph, leaders: list[int], law: FormationLaw, margin_s: float) -> list[Notice]:
    coupling, warnings = couple(graph, leaders, law), []
    damping = min(mode_figures(law.gains, float(value)).damping for value in mode_eigenvalues(coupling))
    if damping < BADLY_DAMPED:
        warnings.append(Notice(Code.BADLY_DAMPED, f"smallest damping {damping:.2f}, 1 is critical"))
    if margin_s < SMALL_DELAY_MARGIN_S:
        warnings.append(Notice(Code.SMALL_DELAY_MARGIN, f"unstable from a loop delay of {margin_s:.3f} s on"))
    gain = string_gains(coupling, MODEL)
    if gain and gain.to_last > GROWS:
        text = f"an oscillation of the leader is up to {gain.to_last:.2f} times as large at the last vehicle"
        warnings.append(Notice(Code.ERRORS_GROW, text))
    return warnings


@dataclass(frozen=True, slots=True)
class FlightResult:
    """One flight: its figures, and what they are drawn from (None where no formation was flown)."""

    summary: RunSummary
    flight: FormationFlight | None


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
) -> RunSummary:
    """`figures`, `tracked` and `smallest_distance_m` are of the tracks from `source`; the rest is from the reports."""
    fleet, stand_in = scenario.fleet, scenario.stand_in
    sensors = stand_in.sensors if isinstance(stand_in.sensors, str) else "as given"
    slots_enu_m = {member.id: member.slot_enu_m for member in fleet.vehicles}
    weighting = law_of(fleet.law).weighting
    return RunSummary(
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
    tick = timing and TickFigures(
        rate_hz=timing.rate_hz, ticks=timing.ticks, missed=timing.missed, late_us=timing.late_us
    )
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


def _flight(scenario: Scenario, watch: FlightWatch, tracks: Tracks, source: TrackSource) -> FormationFlight | None:
    if watch.formation is None:
        return None
    pairs = neighbouring_pairs({member.id: member.slot_enu_m for member in scenario.fleet.vehicles})
    reference = reference_flown(scenario, watch)
    return FormationFlight(scenario.fleet.law.name, tracks, watch.slots(), pairs, reference, watch.formation, source)


FlyOnce = Callable[[Scenario, str, Path, StopRequest], FlightResult]  # scenario, its name, the folder for the results
Prepare = Callable[[Scenario], AbstractContextManager[FlyOnce]]


def run_flights(options: FlightOptions, prepare: Prepare) -> int:
    """Fly as the options require; returns the exit code. Raises what sitl/cli/main.py reports.

    `prepare` reserves what the flights need, before anything is written or flown; it may raise ConfigError or
    PortInUseError.
    """
    with StopRequest("stopped at once; the vehicles were not landed") as stop:
        scenario = load_scenario(options.scenario, options.overrides)
        scenarios = [with_law(scenario, law) for law in _laws(scenario, options)]
        warnings = _convergence_warnings(scenarios, options.anyway)
        name = options.scenario.stem
        stem = f"{name}-{scenario.fleet.law.name}"
        with prepare(scenario) as fly_once, open_folder(options.out, stem) as folder:
            if not options.quiet:
                print("".join(f"warning, {warning}\n" for warning in warnings), end="", flush=True)
            if options.others is None:
                return _fly_one(scenario, name, folder, fly_once, stop)
            return _fly_laws(scenarios, name, folder, fly_once, stop)


def _laws(scenario: Scenario, options: FlightOptions) -> list[LawName]:
    """The scenario's own law, then the others. Raises ConfigError."""
    own = scenario.fleet.law.name
    if options.others is not None and all(step.command is not CommandName.FORM for step in scenario.timeline):
        raise ConfigError(
            options.scenario, "timeline", "has no step with command: form, so --compare has nothing to compare"
        )
    return [own, *(law for law in options.others or () if law != own)]


def _convergence_warnings(scenarios: list[Scenario], anyway: bool) -> list[str]:
    """About the formation under each law, one line each. Raises DivergesError, but not with `anyway`."""
    warnings = []
    for scenario in scenarios:
        law = scenario.fleet.law.name
        try:
            warnings += [f"{law}: {notice}" for notice in check_convergence(scenario)]
        except DivergesError as error:
            if not anyway:
                raise
            warnings.append(f"{law}: {error}")
    return warnings


def _fly_one(scenario: Scenario, name: str, folder: Path, fly_once: FlyOnce, stop: StopRequest) -> int:
    result = fly_once(scenario, name, folder, stop)
    print(f"{in_words(result.summary)}\nresults in {folder}")
    return stop.exit_code if stop.number else _exit_code(result.summary)


def _fly_laws(scenarios: list[Scenario], name: str, folder: Path, fly_once: FlyOnce, stop: StopRequest) -> int:
    """One flight per law, then the table and the figure.

    A law that fails in formation is part of the comparison; a flight without a formation ends it.
    """
    results: list[FlightResult] = []
    for scenario in scenarios:
        result = fly_once(scenario, name, folder / scenario.fleet.law.name, stop)
        results.append(result)
        print(in_words(result.summary) + "\n", flush=True)
        if stop.number or result.flight is None:
            print(f"results so far in {folder}")
            return stop.exit_code if stop.number else EXIT_FAILED
    comparison = compare([result.summary for result in results])
    write_comparison(folder, comparison, [result.flight for result in results if result.flight])
    print(f"{in_a_table(comparison)}\nresults in {folder}")
    return max(_exit_code(result.summary) for result in results)


def _exit_code(summary: RunSummary) -> int:
    return EXIT_FAILED if summary.failure else EXIT_DONE


def run_virtual(options: FlightOptions) -> int:
    """Fly as the options require; returns the exit code."""
    return run_flights(options, lambda _scenario: nullcontext(partial(_run_once, options)))


def _run_once(options: FlightOptions, scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> FlightResult:
    folder.mkdir(parents=True, exist_ok=True)
    write_scenario(scenario, folder)
    progress = FlightProgress(f"{name}, {scenario.fleet.law.name}", options.quiet, began_s=0.0)
    with progress:
        flown = fly_in_virtual_time(scenario, progress, stop, folder if options.record else None)
    for stand_in in flown.stand_ins:
        stand_in.write_track(truth_path(folder, stand_in.vehicle_id))
    return write_results(
        scenario,
        name,
        folder,
        flown.watch,
        flown.tracks(),
        failure=flown.failure,
        flight_s=flown.flight_s,
        real_time_factor=flown.flight_s / flown.wall_s,
    )
