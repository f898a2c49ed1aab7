"""Fleets of real processes: `sitl fly` flies a scenario; `sitl fleet` waits for an operator and only lands at its end."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path

from companion.config.file import ConfigError
from companion.ground.answers import id_list
from companion.ground.commands import MACHINE_CLOCK
from companion.ground.session import FleetSession
from companion.types.autopilot import AutopilotKind
from companion.types.commands import CommandName
from companion.types.errors import EXIT_DONE, EXIT_FAILED
from sitl.flight.director import POLL_S, Director
from sitl.flight.external import ReachedVehicle, Readiness, load_external, vehicles_of
from sitl.flight.files import autopilots_of, estimated_path, ids_of, truth_path
from sitl.flight.flights import FlightEnd, FlightOptions, FlightOrder, FlightResult, FlyOnce, run_flights, write_results
from sitl.flight.orders import REPLY_WITHIN_S, FlightFailure
from sitl.flight.processes import FleetProcesses, publish_targets
from sitl.flight.real_autopilots import RealFleet
from sitl.flight.real_start import start_real
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import FlightWatch, watch_of
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import LOOPBACK, ports_of, zenoh_endpoint
from sitl.report.folder import open_folder
from sitl.report.metrics import TrackError, Tracks, TrackSource, read_track, reported_track, write_track
from sitl.report.progress import FlightProgress
from sitl.report.summary import overload_line
from sitl.stopping import StopRequest
from sitl.vehicle.truth import armed_at_m

FLYING_OPERATOR = "sitl-fly"  # another operator that wants to command these vehicles has to take command first
External = Mapping[int, ReachedVehicle]  # by id
WAITING_OPERATOR = "sitl-fleet"
HOW_TO = """\
fleet {name}, vehicles {ids}. In a second terminal, one after the other:
  {companion} fleet use {file}        from then on this fleet is meant
  {companion} fleet doctor
  {companion} fleet arm        and likewise takeoff, form, ..., land: companion fleet --help
  {companion} monitor --control        or all of this from a page in the browser
MAVLink for a ground station: {ground_links}
Ctrl-C here lands all vehicles and ends."""


def run_fly(options: FlightOptions) -> int:
    """Fly as the options require; returns the exit code. Raises ConfigError."""

    @contextmanager
    def prepare(scenario: Scenario) -> Iterator[FlyOnce]:
        if scenario.agent_ends:
            raise ConfigError(options.scenario, "agent_ends", "ends agents in virtual time only; use sitl run")
        real = _real(options, scenario)
        external = _external(options, scenario) if real is None else None
        autopilots: Mapping[int, AutopilotKind | None] = real.kinds if real else autopilots_of(scenario)
        with reserved_ports(dict.fromkeys(autopilots) if external else autopilots, options.port_offset) as offset:
            if offset and not options.quiet:
                endpoints = " ".join(zenoh_endpoint(i, offset) for i in ids_of(scenario))
                print(f"all ports are offset by {offset}: companion monitor --connect {endpoints}", flush=True)

            reached = real.reached(offset) if real else external
            yield lambda order: _Flight(order, options.quiet, offset, reached, real).result()

    return run_flights(options, prepare)


def fly_real(order: FlightOrder, quiet: bool, real: RealFleet) -> FlightResult:
    """One flight on real autopilots, at the first ports that are free. Raises PortInUseError."""
    with reserved_ports(real.kinds, None) as offset:
        return _Flight(order, quiet, offset, real.reached(offset), real).result()


def _real(options: FlightOptions, scenario: Scenario) -> RealFleet | None:
    """The real autopilots that are to be started, None for all others. Raises ConfigError."""
    named = str(options.external)
    if named in list(AutopilotKind):
        return RealFleet.of(scenario, AutopilotKind(named), options.binary)
    if options.binary:
        raise ConfigError("--binary", "", "goes with --external px4 or --external ardupilot, which start it")
    if options.external and not options.external.exists():
        raise ConfigError("--external", "", f"{named} is neither px4 nor ardupilot nor a file")
    return None


def _external(options: FlightOptions, scenario: Scenario) -> External | None:
    """The external autopilots of the scenario's vehicles, None with stand-ins. Raises ConfigError."""
    file = options.external
    return None if file is None else vehicles_of(file, load_external(file), scenario.fleet)


class _Flight:
    """One scenario flown with processes. With `external` autopilots there are no stand-ins; the `real` ones are started."""

    def __init__(
        self, order: FlightOrder, quiet: bool, port_offset: int, external: External | None, real: RealFleet | None
    ) -> None:
        self._order, self._scenario, self._folder = order, order.scenario, order.folder
        self._port_offset, self._external, self._real = port_offset, external, real
        self._watch = watch_of(order.scenario, time.monotonic())
        self._progress = FlightProgress(order.title, quiet, self._watch.began_s)
        self._doing = ""

    def result(self) -> FlightResult:
        """Fly and write the folder."""
        failure = "; ".join(self._fly()) or None
        flight_s = time.monotonic() - self._watch.began_s
        tracks: Tracks | None = None
        try:
            tracks = self._tracks()
        except TrackError as error:
            failure = failure or str(error)
        real = self._real.kinds if self._real else None
        end = FlightEnd(failure=failure, flight_s=flight_s, source=self._source, real_autopilots=real)
        return write_results(self._order, self._watch, tracks, end)

    @property
    def _source(self) -> TrackSource:
        return "true" if self._external is None or self._real else "estimated"

    def _tracks(self) -> Tracks:
        """The true ones, or those reported by vehicles whose autopilots others have started. Raises TrackError."""
        if self._source == "true":
            return {i: read_track(truth_path(self._folder, i)) for i in ids_of(self._scenario)}
        tracks = {i: reported_track(i, self._watch.reported[i]) for i in ids_of(self._scenario)}
        for vehicle_id, track in tracks.items():
            write_track(estimated_path(self._folder, vehicle_id), track)
        return tracks

    def _fly(self) -> list[str]:
        """Start, fly the timeline, land and stop. Returns the failures, one line each."""
        self._folder.mkdir(parents=True, exist_ok=True)
        fleet_name = self._scenario.fleet.name
        endpoints = [zenoh_endpoint(i, self._port_offset) for i in ids_of(self._scenario)]
        with self._progress, ExitStack() as processes:
            try:
                fleet = processes.enter_context(self._start())
            except FlightFailure as failure:
                return [str(failure)]
            with FleetSession(fleet_name, endpoints, FLYING_OPERATOR) as session, ExitStack() as stack:
                targets = publish_targets(self._scenario, endpoints, self._watch.began_s, stack)

                def check() -> None:
                    self._check_stop()
                    if ending := fleet.unexpected_end():
                        raise FlightFailure(ending)
                    targets.update(time.monotonic())

                def not_to_be_landed() -> set[int]:
                    return fleet.lost_vehicles() | (self._watch.flown_by_others() if self._external else set())

                director = Director(session, self._watch, self._progress, check, not_to_be_landed, MACHINE_CLOCK)
                failures = director.wait_for(Readiness(self._scenario)) if self._external else []
                failures = failures or director.fly_and_land(self._scenario.timeline)
                if self._external and not self._real:
                    failures.extend(_left_in_the_air(self._watch, fleet.lost_vehicles()))
            failures.extend(fleet.stop_all())
        return failures

    def _start(self) -> FleetProcesses:
        """All processes. Raises FlightFailure."""
        if self._real:
            return start_real(self._real, self._folder, self._port_offset, self._starting)
        return FleetProcesses.start(self._scenario, self._folder, self._port_offset, self._external)

    def _starting(self, doing: str) -> None:
        """Show it and wait a moment. Raises FlightFailure."""
        if doing != self._doing:
            self._doing = doing
            self._progress.begin_step(doing, time.monotonic())
        if self._progress.is_due():
            self._progress.show((), time.monotonic())
        time.sleep(POLL_S)
        self._check_stop()

    def _check_stop(self) -> None:
        """Raises FlightFailure."""
        if self._order.stop.number:
            raise FlightFailure(f"interrupted by {self._order.stop.number.name}")


def _left_in_the_air(watch: FlightWatch, lost: set[int]) -> list[str]:
    """External vehicles that are not on the ground, and why, one line each."""
    lines = []
    if alone := [
        status.agent.vehicle_id
        for status in watch.statuses()
        if status.autopilot.armed and status.agent.vehicle_id in lost
    ]:
        lines.append(f"{id_list(alone)} left armed, without an agent that could land it: use a ground station")
    if others := sorted(watch.flown_by_others() - lost):
        lines.append(f"{id_list(others)} left in the air: another operator or the autopilot set its mode")
    return lines


def run_fleet(options: FlightOptions) -> int:
    """The exit code. Raises what sitl/cli/main.py reports."""
    scenario = load_scenario(options.scenario, options.overrides)
    stem = f"fleet-{options.scenario.stem}"
    with (
        reserved_ports(autopilots_of(scenario), options.port_offset) as offset,
        open_folder(options.out, stem) as folder,
        StopRequest("stopped at once; the vehicles were not landed") as stop,
    ):
        lines, failed = _wait_and_land(scenario, folder, offset, options.quiet, stop)
    print("\n".join(lines))
    return EXIT_FAILED if failed else EXIT_DONE


def _wait_and_land(
    scenario: Scenario, folder: Path, offset: int, quiet: bool, stop: StopRequest
) -> tuple[list[str], bool]:
    """What is to be reported, one line each, and whether landing or stopping failed."""
    ids = ids_of(scenario)
    endpoints = [zenoh_endpoint(vehicle_id, offset) for vehicle_id in ids]
    watch = watch_of(scenario, time.monotonic())
    progress = FlightProgress(scenario.fleet.name, quiet, watch.began_s)
    failures: list[str] = []
    endings: list[str] = []
    with FleetProcesses.start(scenario, folder, offset) as fleet, progress:
        with FleetSession(scenario.fleet.name, endpoints, WAITING_OPERATOR) as session, ExitStack() as stack:
            targets = publish_targets(scenario, endpoints, watch.began_s, stack)

            def update() -> None:
                while ending := fleet.unexpected_end():  # the operator may have killed it to see how the others react
                    endings.append(ending)
                    progress.remark("; ".join(endings))
                targets.update(time.monotonic())

            director = Director(session, watch, progress, update, fleet.lost_vehicles, MACHINE_CLOCK)
            print(_how_to(scenario, folder, offset), flush=True)
            director.attend(lambda: stop.number is not None or fleet.lost_vehicles().issuperset(ids))
            session.ask(set(ids) - fleet.lost_vehicles(), CommandName.TAKE, REPLY_WITHIN_S)
            if still_up := director.land_all():
                failures.append(still_up)
        lost, failed = fleet.lost_vehicles(), fleet.ended_by_themselves()
        endings.extend(iter(fleet.unexpected_end, None))
        failures.extend(fleet.stop_all())
        failures.extend(left_armed(folder, lost))
    busy = watch.overload()
    lines = [*([overload_line(busy)] if busy else []), *endings, *failures]
    if not failures:
        lines.append(f"{landed_in_words(ids, lost)}; files and logs in {folder}")
    return lines, bool(failures or failed)


def landed_in_words(ids: Collection[int], lost: Collection[int]) -> str:
    """Which vehicles have landed, where none was left in the air: nothing is known of one whose processes have ended."""
    landed = sorted(set(ids).difference(lost))
    if len(landed) == len(ids):
        return "all landed"
    gone = f"an agent or a stand-in of {id_list(lost)} had ended"
    return f"{id_list(landed)} landed, {gone}" if landed else gone


def left_armed(folder: Path, lost: Iterable[int]) -> list[str]:
    """A line for each vehicle without an agent or stand-in that was armed to the end: no command could land it."""
    heights_m = {i: armed_at_m(truth_path(folder, i)) for i in sorted(lost)}
    return [
        f"vehicle {i} was left armed at {height_m:.1f} m: its agent or stand-in had ended"
        for i, height_m in heights_m.items()
        if height_m is not None
    ]


def companion_program() -> str:
    """How a terminal in the present folder calls `companion`: by its name where that is in PATH, else by its path."""
    if shutil.which("companion"):
        return "companion"
    program = Path(sys.executable).with_name("companion")
    return str(program.relative_to(Path.cwd()) if program.is_relative_to(Path.cwd()) else program)


def _how_to(scenario: Scenario, folder: Path, offset: int) -> str:
    ids = ids_of(scenario)
    first, last = (ports_of(vehicle_id, offset).ground_link for vehicle_id in (ids[0], ids[-1]))
    return HOW_TO.format(
        name=scenario.fleet.name,
        ids=", ".join(map(str, ids)),
        file=folder / "fleet.yaml",
        companion=companion_program(),
        ground_links=f"udpout:{LOOPBACK}:{first}" + (f" (vehicle {ids[0]}) to {last} (vehicle {ids[-1]})"),
    )
