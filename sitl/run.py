"""One command from a scenario file to a folder of figures in virtual time: `sitl run`."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from companion.types import Role
from sitl.director import Director, FlightFailure
from sitl.fleet import ids_of, truth_path, write_scenario
from sitl.flights import Result, run_flights, write_results
from sitl.lockstep import Lockstep
from sitl.progress import Progress
from sitl.run_options import RunOptions
from sitl.scenario import Scenario
from sitl.stopping import StopRequest
from sitl.tracks import Track
from sitl.watch import FlightWatch
from sitl.world import StandIn


@dataclass(frozen=True, slots=True)
class Flown:
    """One flight in virtual time. `watch` holds what the vehicles said, `wall_s` is how long the machine took."""

    watch: FlightWatch
    stand_ins: list[StandIn]
    failure: str | None
    flight_s: float
    wall_s: float

    def tracks(self) -> dict[int, Track]:
        return {stand_in.vehicle_id: stand_in.track() for stand_in in self.stand_ins}


def run(options: RunOptions) -> int:
    """Fly as the options say; the exit code."""
    return run_flights(options, partial(_run_once, options))


def fly_in_virtual_time(scenario: Scenario, progress: Progress, stop: StopRequest | None = None) -> Flown:
    """The scenario's whole timeline, and down in any case."""

    def check() -> None:
        if stop and stop.number:
            raise FlightFailure(f"interrupted by {stop.number.name}")

    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    began_s = time.perf_counter()
    lockstep = Lockstep(scenario)
    watch = FlightWatch(ids_of(scenario), leader_ids, lockstep.now_s())
    director = Director(lockstep, watch, progress, check, tuple, lockstep)
    failures = director.fly_and_land(scenario.timeline)
    wall_s = time.perf_counter() - began_s
    return Flown(watch, lockstep.stand_ins, "; ".join(failures) or None, lockstep.now_s(), wall_s)


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
