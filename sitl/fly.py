"""One command from a scenario file to a folder of figures: `sitl fly`. A flight with real processes."""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path

from companion.ground.session import FleetSession
from companion.ground.target import TargetPublisher
from companion.types import Role
from sitl.director import Director, MachineClock
from sitl.external import ReachedVehicle, load_external, vehicles_of
from sitl.fleet import Fleet, endpoint_of, estimated_path, ids_of, truth_path
from sitl.flights import Result, run_flights, write_results
from sitl.fly_options import FlyOptions
from sitl.free_ports import check_agents_ports, check_ports
from sitl.metrics import Tracks
from sitl.moving_targets import MovingTargets
from sitl.orders import FlightFailure
from sitl.progress import Progress
from sitl.readiness import Readiness
from sitl.scenario import Scenario
from sitl.stopping import StopRequest
from sitl.tracks import TrackError, read_track, told_track, write_track
from sitl.watch import FlightWatch, vehicles_in_words

OPERATOR = "sitl-fly"  # whoever else would command these vehicles has to take it over
External = Mapping[int, ReachedVehicle]  # by id


def run_fly(options: FlyOptions) -> int:
    """Fly as the options say; the exit code. Raises ConfigError."""
    if options.external:
        return _run_external(options, options.external)

    def fly_once(scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> Result:
        return _fly_stand_ins(scenario, name, folder, options, stop)

    def ports_are_free(scenario: Scenario) -> None:
        check_ports(ids_of(scenario), scenario.stand_in.autopilot, options.port_offset)

    return run_flights(options.run, fly_once, ports_are_free)


def _run_external(options: FlyOptions, file: Path) -> int:
    reached = load_external(file)

    def fly_once(scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> Result:
        return _fly_external(scenario, name, folder, options, vehicles_of(file, reached, scenario.fleet), stop)

    def all_are_named(scenario: Scenario) -> None:
        vehicles_of(file, reached, scenario.fleet)
        check_agents_ports(ids_of(scenario), options.port_offset)

    return run_flights(options.run, fly_once, all_are_named)


def _fly_stand_ins(scenario: Scenario, name: str, folder: Path, options: FlyOptions, stop: StopRequest) -> Result:
    """Fly one scenario with stand-ins and write its folder."""
    watch, failure = _fly(scenario, name, folder, options, None, stop)
    flight_s = time.monotonic() - watch.began_s
    tracks: Tracks | None = None
    try:
        tracks = {vehicle_id: read_track(truth_path(folder, vehicle_id)) for vehicle_id in ids_of(scenario)}
    except TrackError as error:
        failure = failure or str(error)
    return write_results(scenario, name, folder, watch, tracks, failure, flight_s)


def _fly_external(
    scenario: Scenario, name: str, folder: Path, options: FlyOptions, external: External, stop: StopRequest
) -> Result:
    """Fly one scenario with vehicles that something else has started, and write its folder."""
    watch, failure = _fly(scenario, name, folder, options, external, stop)
    flight_s = time.monotonic() - watch.began_s
    tracks: Tracks | None = None
    try:
        tracks = {vehicle_id: told_track(vehicle_id, watch.told[vehicle_id]) for vehicle_id in ids_of(scenario)}
        for vehicle_id, track in tracks.items():
            write_track(estimated_path(folder, vehicle_id), track)
    except TrackError as error:
        failure = failure or str(error)
    return write_results(scenario, name, folder, watch, tracks, failure, flight_s, source="estimated")


def _fly(
    scenario: Scenario, name: str, folder: Path, options: FlyOptions, external: External | None, stop: StopRequest
) -> tuple[FlightWatch, str | None]:
    """Start, fly the timeline, land and stop. What was seen, and what went wrong, in one line."""
    folder.mkdir(parents=True, exist_ok=True)
    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    watch = FlightWatch(ids_of(scenario), leader_ids, time.monotonic())
    progress = Progress(f"{name}, {scenario.fleet.law.name}", options.run.quiet, watch.began_s)
    endpoints = [endpoint_of(vehicle_id, options.port_offset) for vehicle_id in ids_of(scenario)]
    with Fleet.start(scenario, folder, options.port_offset, external) as fleet:
        with FleetSession.open(scenario.fleet.name, endpoints, OPERATOR) as session, ExitStack() as voices:
            told = {
                target.name: voices.enter_context(TargetPublisher.open(scenario.fleet.name, endpoints, target.name))
                for target in scenario.targets
            }
            targets = MovingTargets(scenario.targets, lambda name, v, x: told[name].tell(v, x), watch.began_s)

            def check() -> None:
                if stop.number:
                    raise FlightFailure(f"interrupted by {stop.number.name}")
                if ending := fleet.unexpected_end():
                    raise FlightFailure(ending)
                targets.go_on(time.monotonic())

            def not_to_be_landed() -> set[int]:
                return fleet.lost_vehicles() | (watch.flown_by_others() if external else set())

            director = Director(session, watch, progress, check, not_to_be_landed, MachineClock())
            failures = director.wait_for(Readiness(scenario)) if external else []
            failures = failures or director.fly_and_land(scenario.timeline)
            if external:
                failures.extend(_left_in_the_air(watch, fleet.lost_vehicles()))
        if killed := fleet.stop():
            failures.append(f"{', '.join(killed)} did not end when told to and had to be killed")
    return watch, "; ".join(failures) or None


def _left_in_the_air(watch: FlightWatch, lost: set[int]) -> list[str]:
    """Which vehicles of somebody else are not down, and why."""
    words = []
    if alone := [i for i in sorted(lost) if watch.is_armed(i)]:
        words.append(
            f"{vehicles_in_words(alone)} left armed, without an agent that could land it: use a ground station"
        )
    if others := sorted(watch.flown_by_others() - lost):
        words.append(f"{vehicles_in_words(others)} left in the air, to whoever set its mode")
    return words
