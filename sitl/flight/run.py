"""`sitl run`: from a scenario file to a folder of figures in virtual time."""

from __future__ import annotations

from contextlib import nullcontext
from functools import partial
from pathlib import Path

from sitl.flight.files import truth_path, write_scenario
from sitl.flight.flights import run_flights
from sitl.flight.options import RunOptions
from sitl.flight.results import FlightResult, write_results
from sitl.flight.scenario import Scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import Progress
from sitl.stopping import StopRequest


def run_virtual(options: RunOptions) -> int:
    """Fly as the options require; returns the exit code."""
    return run_flights(options, lambda _scenario: nullcontext(partial(_run_once, options)))


def _run_once(options: RunOptions, scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> FlightResult:
    folder.mkdir(parents=True, exist_ok=True)
    write_scenario(scenario, folder)
    progress = Progress(f"{name}, {scenario.fleet.law.name}", options.quiet, began_s=0.0)
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
