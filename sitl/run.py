"""One command from a scenario file to a folder of figures in virtual time: `sitl run`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

from sitl.fleet import truth_path, write_scenario
from sitl.flights import Result, run_flights, write_results
from sitl.progress import Progress
from sitl.run_options import RunOptions
from sitl.scenario import Scenario
from sitl.stopping import StopRequest
from sitl.virtual_flight import fly_in_virtual_time


def run(options: RunOptions) -> int:
    """Fly as the options say; the exit code."""
    return run_flights(options, partial(_run_once, options))


def _run_once(options: RunOptions, scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> Result:
    folder.mkdir(parents=True, exist_ok=True)
    write_scenario(scenario, folder)
    progress = Progress(f"{name}, {scenario.fleet.law.name}", options.quiet, began_s=0.0)
    flown = fly_in_virtual_time(scenario, progress, stop)
    for stand_in in flown.stand_ins:
        stand_in.write_track(truth_path(folder, stand_in.vehicle_id))
    return write_results(
        scenario,
        name,
        folder,
        flown.watch,
        flown.tracks(),
        flown.failure,
        flown.flight_s,
        real_time_factor=flown.flight_s / flown.wall_s,
    )
