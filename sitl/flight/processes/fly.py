"""`sitl fly`: from a scenario file to a folder of figures, flown with real processes."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from companion.config.file import ConfigError
from companion.ground.session import FleetSession
from sitl.flight.director import Director, MachineClock
from sitl.flight.external import ReachedVehicle, load_external, vehicles_of
from sitl.flight.files import estimated_path, ids_of, truth_path
from sitl.flight.flights import FlyOnce, run_flights
from sitl.flight.options import FlyOptions
from sitl.flight.orders import FlightFailure
from sitl.flight.processes.fleet import FleetProcesses
from sitl.flight.processes.target_publishers import publish_targets
from sitl.flight.readiness import Readiness
from sitl.flight.results import FlightResult, write_results
from sitl.flight.scenario import Scenario
from sitl.flight.watch import FlightWatch, vehicles_in_words, watch_of
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import zenoh_endpoint
from sitl.report.metrics import Tracks, TrackSource
from sitl.report.progress import Progress
from sitl.report.tracks import TrackError, read_track, reported_track, write_track
from sitl.stopping import StopRequest

FLYING_OPERATOR = "sitl-fly"  # another operator that wants to command these vehicles has to take command first
External = Mapping[int, ReachedVehicle]  # by id


def run_fly(options: FlyOptions) -> int:
    """Fly as the options require; returns the exit code. Raises ConfigError."""

    @contextmanager
    def prepare(scenario: Scenario) -> Iterator[FlyOnce]:
        if scenario.agent_ends:
            raise ConfigError(options.run.scenario, "agent_ends", "ends agents in virtual time only; use sitl run")
        external = _external(options, scenario)
        kind = scenario.stand_in.autopilot if external is None else None
        with reserved_ports(ids_of(scenario), kind, options.port_offset) as offset:
            if offset and not options.run.quiet:
                endpoints = " ".join(zenoh_endpoint(i, offset) for i in ids_of(scenario))
                print(f"all ports are offset by {offset}: companion monitor --connect {endpoints}", flush=True)

            def fly_once(scenario: Scenario, name: str, folder: Path, stop: StopRequest) -> FlightResult:
                return _Flight(scenario, name, folder, options.run.quiet, offset, external, stop).result()

            yield fly_once

    return run_flights(options.run, prepare)


def _external(options: FlyOptions, scenario: Scenario) -> External | None:
    """The external autopilots of the scenario's vehicles, None with stand-ins. Raises ConfigError."""
    file = options.external
    return None if file is None else vehicles_of(file, load_external(file), scenario.fleet)


class _Flight:
    """One scenario flown with processes. With `external` autopilots there are no stand-ins."""

    def __init__(
        self,
        scenario: Scenario,
        name: str,
        folder: Path,
        quiet: bool,
        port_offset: int,
        external: External | None,
        stop: StopRequest,
    ) -> None:
        self._scenario, self._name, self._folder = scenario, name, folder
        self._port_offset, self._external, self._stop = port_offset, external, stop
        self._watch = watch_of(scenario, time.monotonic())
        self._progress = Progress(f"{name}, {scenario.fleet.law.name}", quiet, self._watch.began_s)

    def result(self) -> FlightResult:
        """Fly and write the folder."""
        failure = "; ".join(self._fly()) or None
        flight_s = time.monotonic() - self._watch.began_s
        tracks: Tracks | None = None
        try:
            tracks = self._true_tracks() if self._external is None else self._estimated_tracks()
        except TrackError as error:
            failure = failure or str(error)
        source: TrackSource = "true" if self._external is None else "estimated"
        return write_results(
            self._scenario,
            self._name,
            self._folder,
            self._watch,
            tracks,
            failure=failure,
            flight_s=flight_s,
            source=source,
        )

    def _true_tracks(self) -> Tracks:
        return {i: read_track(truth_path(self._folder, i)) for i in ids_of(self._scenario)}

    def _estimated_tracks(self) -> Tracks:
        tracks = {i: reported_track(i, self._watch.reported[i]) for i in ids_of(self._scenario)}
        for vehicle_id, track in tracks.items():
            write_track(estimated_path(self._folder, vehicle_id), track)
        return tracks

    def _fly(self) -> list[str]:
        """Start, fly the timeline, land and stop. Returns the failures, one line each."""
        self._folder.mkdir(parents=True, exist_ok=True)
        fleet_name = self._scenario.fleet.name
        endpoints = [zenoh_endpoint(i, self._port_offset) for i in ids_of(self._scenario)]
        with (
            FleetProcesses.start(self._scenario, self._folder, self._port_offset, self._external) as fleet,
            self._progress,
        ):
            with FleetSession(fleet_name, endpoints, FLYING_OPERATOR) as session, ExitStack() as stack:
                targets = publish_targets(self._scenario, endpoints, self._watch.began_s, stack)

                def check() -> None:
                    if self._stop.number:
                        raise FlightFailure(f"interrupted by {self._stop.number.name}")
                    if ending := fleet.unexpected_end():
                        raise FlightFailure(ending)
                    targets.update(time.monotonic())

                def not_to_be_landed() -> set[int]:
                    return fleet.lost_vehicles() | (self._watch.flown_by_others() if self._external else set())

                director = Director(session, self._watch, self._progress, check, not_to_be_landed, MachineClock())
                failures = director.wait_for(Readiness(self._scenario)) if self._external else []
                failures = failures or director.fly_and_land(self._scenario.timeline)
                if self._external:
                    failures.extend(_left_in_the_air(self._watch, fleet.lost_vehicles()))
            failures.extend(fleet.stop_all())
        return failures


def _left_in_the_air(watch: FlightWatch, lost: set[int]) -> list[str]:
    """External vehicles that are not on the ground, and why, one line each."""
    lines = []
    if alone := [i for i in sorted(lost) if watch.is_armed(i)]:
        lines.append(
            f"{vehicles_in_words(alone)} left armed, without an agent that could land it: use a ground station"
        )
    if others := sorted(watch.flown_by_others() - lost):
        lines.append(f"{vehicles_in_words(others)} left in the air: another operator or the autopilot set its mode")
    return lines
