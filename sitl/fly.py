"""One command from a scenario file to a folder of figures: `sitl fly`. A flight with real processes."""

from __future__ import annotations

import time
from pathlib import Path

from companion.ground.session import FleetSession
from companion.types import Role
from sitl.director import Director, FlightFailure, MachineClock
from sitl.fleet import Fleet, check_ports, endpoint_of, ids_of, truth_path
from sitl.flights import Result, run_flights, write_results
from sitl.fly_options import FlyOptions
from sitl.progress import Progress
from sitl.scenario import Scenario
from sitl.stopping import StopRequest
from sitl.tracks import TrackError, read_track
from sitl.watch import FlightWatch


def run_fly(options: FlyOptions) -> int:
    """Fly as the options say; the exit code."""

    def fly_once(scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> Result:
        return _fly_once(scenario, name, folder, options, stop)

    def ports_are_free(scenario: Scenario) -> None:
        check_ports(ids_of(scenario), scenario.stand_in.autopilot, options.port_offset)

    return run_flights(options.run, fly_once, ports_are_free)


def _fly_once(scenario: Scenario, name: str, folder: Path, options: FlyOptions, stop: StopRequest) -> Result:
    """Fly one scenario with real processes and write its folder."""
    folder.mkdir(parents=True, exist_ok=True)
    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    watch = FlightWatch(ids_of(scenario), leader_ids, time.monotonic())
    progress = Progress(f"{name}, {scenario.fleet.law.name}", options.run.quiet, watch.began_s)
    failure = _fly(scenario, folder, options.port_offset, watch, progress, stop)
    flight_s = time.monotonic() - watch.began_s
    tracks = None
    try:
        tracks = {vehicle_id: read_track(truth_path(folder, vehicle_id)) for vehicle_id in ids_of(scenario)}
    except TrackError as error:
        failure = failure or str(error)
    return write_results(scenario, name, folder, watch, tracks, failure, flight_s)


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
            failures = director.fly_and_land(scenario.timeline)
        if killed := fleet.stop():
            failures.append(f"{', '.join(killed)} did not end when told to and had to be killed")
    return "; ".join(failures) or None
