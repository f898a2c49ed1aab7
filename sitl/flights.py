"""From a scenario file to a folder of results, under one law or several; how each flight is flown is given."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from companion.config.reference import TargetReference
from companion.config_file import ConfigError
from companion.core.reference import ReferenceTrajectory
from companion.types import CommandName
from sitl.compare import compare, in_a_table, with_law, write_comparison
from sitl.ending import EXIT_DONE, EXIT_FAILED
from sitl.metrics import Flight, Tracks, TrackSource, formation_figures, neighbouring_pairs, smallest_distance_m
from sitl.run_options import LAWS, RunOptions
from sitl.scenario import Scenario, load_scenario, reference_of
from sitl.stopping import StopRequest
from sitl.summary import Summary, in_words, summarize, write_json
from sitl.tracking import tracking
from sitl.watch import FlightWatch


@dataclass(frozen=True, slots=True)
class Result:
    """One flight: its figures, and what they are drawn from (None where no formation was flown)."""

    summary: Summary
    flight: Flight | None


OWN_FILES = re.compile(
    r"summary\.json|comparison\.(json|png)|figure_[56]\.png|from_above\.png|(scenario|fleet|vehicle_\d+|autopilot_\d+)\.yaml"
    r"|(truth|estimated)_\d+\.csv|(agent|autopilot)_\d+\.log"
)

FlyOnce = Callable[[Scenario, str, Path, StopRequest], Result]  # scenario, its name, the folder for the results


def run_flights(options: RunOptions, fly_once: FlyOnce, check: Callable[[Scenario], None] | None = None) -> int:
    """Fly as the options say; the exit code. Raises what sitl/ending.py puts into words.

    `check` is called before anything is written or flown; it may raise ConfigError or PortInUseError.
    """
    with StopRequest("stopped at once; nothing was landed") as stop:
        return _run(options, fly_once, check, stop)


def _run(options: RunOptions, fly_once: FlyOnce, check: Callable[[Scenario], None] | None, stop: StopRequest) -> int:
    scenario = load_scenario(options.scenario, options.overrides)
    if options.others is not None and all(step.command is not CommandName.FORM for step in scenario.timeline):
        raise ConfigError(
            options.scenario, "timeline", "has no step with command: form, so --compare has nothing to compare"
        )
    if check:
        check(scenario)
    name = options.scenario.stem
    folder = options.out or Path("runs") / f"{name}-{scenario.fleet.law.name}-{datetime.now():%Y%m%d-%H%M%S}"
    remove_old_run(folder)
    if options.others is None:
        result = fly_once(scenario, name, folder, stop)
        print(f"{in_words(result.summary)}\nresults in {folder}")
        return stop.exit_code if stop.number else _exit_code(result.summary)
    return _fly_laws(scenario, name, folder, options, fly_once, stop)


def remove_old_run(folder: Path) -> None:
    """An older run's files, also of its laws, so that none of them stays beside the new ones. Raises OSError.

    It was a run if there are tracks with the scenario as flown; nothing else is touched.
    """
    for place in (folder, *(folder / law for law in LAWS)):
        files = [file for file in place.iterdir() if OWN_FILES.fullmatch(file.name)] if place.is_dir() else []
        names = {file.name for file in files}
        if "comparison.json" in names or (
            "scenario.yaml" in names and any(name.startswith(("truth_", "estimated_")) for name in names)
        ):
            for file in files:
                file.unlink()
            if place != folder and not any(place.iterdir()):
                place.rmdir()


def _fly_laws(
    scenario: Scenario, name: str, folder: Path, options: RunOptions, fly_once: FlyOnce, stop: StopRequest
) -> int:
    """The scenario's own law and then the others; then the table and the figure.

    A law that fails in formation is part of the comparison; a flight that never got there ends it.
    """
    own = scenario.fleet.law.name
    laws = [own, *(law for law in options.others or () if law != own)]
    results: list[Result] = []
    for law in laws:
        result = fly_once(with_law(scenario, law), name, folder / law, stop)
        results.append(result)
        print(in_words(result.summary) + "\n", flush=True)
        if stop.number or result.flight is None:
            print(f"results so far in {folder}")
            return stop.exit_code if stop.number else EXIT_FAILED
    comparison = compare([result.summary for result in results])
    write_comparison(folder, comparison, [result.flight for result in results if result.flight])
    print(f"{in_a_table(comparison)}\nresults in {folder}")
    return max(_exit_code(result.summary) for result in results)


def _exit_code(summary: Summary) -> int:
    return EXIT_FAILED if summary.failure else EXIT_DONE


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
) -> Result:
    """summary.json and, where a formation was flown, its figures. `tracks` is None where nothing is known of them."""
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
        from sitl.plan_view import save_plan_view  # matplotlib takes its time and memory
        from sitl.plots import save_figure_5, save_figure_6

        save_figure_5(folder / "figure_5.png", flight, name)
        save_figure_6(folder / "figure_6.png", flight, name)
        save_plan_view(folder / "from_above.png", flight, watch, name)
    return Result(summary, flight)


def reference_flown(scenario: Scenario, watch: FlightWatch) -> ReferenceTrajectory:
    """The scenario's own, where nothing else could come of it."""
    changes = any(step.command is CommandName.REFERENCE for step in scenario.timeline)
    told = changes or isinstance(scenario.reference, TargetReference)
    return watch.told_reference() if told and len(watch.reference) > 1 else reference_of(scenario)


def _flight(scenario: Scenario, watch: FlightWatch, tracks: Tracks, source: TrackSource) -> Flight | None:
    if watch.formation is None:
        return None
    pairs = neighbouring_pairs({member.id: member.slot_enu_m for member in scenario.fleet.vehicles})
    reference = reference_flown(scenario, watch)
    return Flight(scenario.fleet.law.name, tracks, watch.slots(), pairs, reference, watch.formation, source)
