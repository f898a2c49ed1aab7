"""One command from a scenario file to a folder of figures: `sitl fly`. The composition of a run."""

from __future__ import annotations

import os
import sys
import time
from dataclasses import dataclass
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

from companion.config_file import ConfigError
from companion.ground.session import FleetSession
from companion.types import CommandName, Role
from sitl.compare import compare, in_a_table, with_law, write_comparison
from sitl.director import Director, FlightFailure, MachineClock
from sitl.fleet import Fleet, PortInUseError, check_ports, endpoint_of, ids_of, truth_path
from sitl.fly_options import FlyOptions
from sitl.metrics import Flight, Tracks, formation_figures, neighbouring_pairs, smallest_distance_m
from sitl.progress import Progress
from sitl.scenario import Scenario, load_scenario, reference_of
from sitl.stopping import StopNow, StopRequest
from sitl.summary import Summary, in_words, summarize, write_json
from sitl.tracks import TrackError, read_track
from sitl.watch import FlightWatch

EXIT_FLOWN, EXIT_FAILED, EXIT_UNUSABLE = 0, 1, 2


def run_fly(options: FlyOptions) -> int:
    """Fly as the options say; the exit code. Everything that a user can cause ends in one line."""
    with StopRequest() as stop:
        try:
            code = _run(options, stop)
            sys.stdout.flush()
            return code
        except (ConfigError, PortInUseError) as error:
            print(error, file=sys.stderr)
            return EXIT_UNUSABLE
        except BrokenPipeError:  # the reader of a pipe has gone; the flight is over and its folder is written
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return EXIT_FAILED
        except OSError as error:
            print(f"{error.filename}: {error.strerror}; choose another folder with --out", file=sys.stderr)
            return EXIT_UNUSABLE
        except StopNow:
            print("stopped at once; nothing was landed", file=sys.stderr)
            return stop.exit_code


def _run(options: FlyOptions, stop: StopRequest) -> int:
    if find_spec("matplotlib") is None:
        raise ConfigError("sitl fly", "matplotlib", "is not installed; pip install 'formation-companion[ground]'")
    scenario = load_scenario(options.scenario, options.overrides)
    if options.others is not None and all(step.command is not CommandName.FORM for step in scenario.timeline):
        raise ConfigError(
            options.scenario, "timeline", "has no step with command: form, so --compare has nothing to compare"
        )
    check_ports(ids_of(scenario), options.port_offset)
    name = options.scenario.stem
    folder = options.out or Path("runs") / f"{name}-{scenario.fleet.law.name}-{datetime.now():%Y%m%d-%H%M%S}"
    if options.others is None:
        result = fly_once(scenario, name, folder, options, stop)
        print(f"{in_words(result.summary)}\nresults in {folder}")
        return stop.exit_code if stop.number else _exit_code(result.summary)
    return _fly_laws(scenario, name, folder, options, stop)


def _fly_laws(scenario: Scenario, name: str, folder: Path, options: FlyOptions, stop: StopRequest) -> int:
    """The scenario's own law and then the others; then the table and the figure.

    A law that fails in formation is part of the comparison; a flight that never got there ends it.
    """
    own = scenario.fleet.law.name
    laws = [own, *(law for law in options.others or () if law != own)]
    results: list[Result] = []
    for law in laws:
        result = fly_once(with_law(scenario, law), name, folder / law, options, stop)
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
    return EXIT_FAILED if summary.failure else EXIT_FLOWN


@dataclass(frozen=True, slots=True)
class Result:
    """One flight: its figures, and what they are drawn from (None where no formation was flown)."""

    summary: Summary
    flight: Flight | None


def fly_once(scenario: Scenario, name: str, folder: Path, options: FlyOptions, stop: StopRequest) -> Result:
    """Fly one scenario with real processes and write its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    watch = FlightWatch(ids_of(scenario), leader_ids, time.monotonic())
    progress = Progress(f"{name}, {scenario.fleet.law.name}", options.quiet, watch.began_s)
    failure = _fly(scenario, folder, options.port_offset, watch, progress, stop)
    flight_s = time.monotonic() - watch.began_s
    try:
        tracks = {vehicle_id: read_track(truth_path(folder, vehicle_id)) for vehicle_id in ids_of(scenario)}
    except TrackError as error:
        return _without_tracks(scenario, name, folder, watch, failure or str(error), flight_s)
    flight = _flight(scenario, watch, tracks)
    figures = formation_figures(tracks, flight.slots_enu_m, flight.reference, flight.formation) if flight else None
    summary = summarize(scenario, name, watch, figures, smallest_distance_m(tracks), failure, flight_s)
    write_json(folder / "summary.json", summary)
    if flight:
        from sitl.plots import save_figure_5, save_figure_6

        save_figure_5(folder / "figure_5.png", flight, name)
        save_figure_6(folder / "figure_6.png", flight, name)
    return Result(summary, flight)


def _without_tracks(
    scenario: Scenario, name: str, folder: Path, watch: FlightWatch, failure: str, flight_s: float
) -> Result:
    summary = summarize(scenario, name, watch, None, None, failure, flight_s)
    write_json(folder / "summary.json", summary)
    return Result(summary, None)


def _flight(scenario: Scenario, watch: FlightWatch, tracks: Tracks) -> Flight | None:
    if watch.formation is None:
        return None
    slots_enu_m = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    pairs = neighbouring_pairs(slots_enu_m)
    return Flight(scenario.fleet.law.name, tracks, slots_enu_m, pairs, reference_of(scenario), watch.formation)


def _fly(
    scenario: Scenario, folder: Path, port_offset: int, watch: FlightWatch, progress: Progress, stop: StopRequest
) -> str | None:
    """Start, fly the timeline, land and stop. What went wrong, in one line."""
    endpoints = [endpoint_of(vehicle_id, port_offset) for vehicle_id in ids_of(scenario)]
    with Fleet.start(scenario, folder, port_offset) as fleet:
        with FleetSession.open(scenario.fleet.name, endpoints) as session:

            def check() -> None:
                if stop.number:
                    raise FlightFailure(f"interrupted by {stop.number.name}")
                if ending := fleet.unexpected_end():
                    raise FlightFailure(ending)

            director = Director(session, watch, progress, check, fleet.lost_vehicles, MachineClock())
            failures = []
            try:
                director.fly(scenario.timeline)
            except FlightFailure as failure:
                failures.append(str(failure))
            if still_up := director.land_all():
                failures.append(still_up)
        if killed := fleet.stop():
            failures.append(f"{', '.join(killed)} did not end when told to and had to be killed")
    return "; ".join(failures) or None
