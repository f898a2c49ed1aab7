"""`sitl fleet`: a simulated fleet that waits for an operator. No command is given here before its end."""

from __future__ import annotations

import shutil
import sys
import time
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path

from companion.ground.session import FleetSession
from companion.types.commands import CommandName
from sitl.errors import EXIT_DONE, EXIT_FAILED
from sitl.flight.director import Director, MachineClock
from sitl.flight.files import ids_of, truth_path
from sitl.flight.options import FleetOptions
from sitl.flight.orders import REPLY_WITHIN_S
from sitl.flight.processes.fleet import FleetProcesses
from sitl.flight.processes.target_publishers import publish_targets
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.watch import watch_of
from sitl.links.free_ports import reserved_ports
from sitl.links.ports import LOOPBACK, ports_of, zenoh_endpoint
from sitl.report.folder import open_folder
from sitl.report.load import overload_line
from sitl.report.progress import Progress
from sitl.stopping import StopRequest
from sitl.vehicle.truth import armed_at_m

WAITING_OPERATOR = "sitl-fleet"
HOW_TO = """\
fleet {name}, vehicles {ids}. In a second terminal, one after the other:
  {companion} fleet use {file}        from then on this fleet is meant
  {companion} fleet doctor
  {companion} fleet arm        and likewise takeoff, form, ..., land: companion fleet --help
  {companion} monitor --control        or all of this from a page in the browser
MAVLink for a ground station: {ground_links}
Ctrl-C here lands all vehicles and ends."""


def run_fleet(options: FleetOptions) -> int:
    """The exit code. Raises the errors that sitl/cli/ending.py reports."""
    scenario = load_scenario(options.scenario, options.overrides)
    stem = f"fleet-{options.scenario.stem}"
    with (
        reserved_ports(ids_of(scenario), scenario.stand_in.autopilot, options.port_offset) as offset,
        open_folder(options.out, stem) as folder,
        StopRequest("stopped at once; the vehicles were not landed") as stop,
    ):
        lines, failed = _wait_and_land(scenario, folder, offset, options.quiet, stop)
    print("\n".join(lines if failed else [*lines, f"all landed; files and logs in {folder}"]))
    return EXIT_FAILED if failed else EXIT_DONE


def _wait_and_land(
    scenario: Scenario, folder: Path, offset: int, quiet: bool, stop: StopRequest
) -> tuple[list[str], bool]:
    """What is to be reported, one line each, and whether landing or stopping failed."""
    ids = ids_of(scenario)
    endpoints = [zenoh_endpoint(vehicle_id, offset) for vehicle_id in ids]
    watch = watch_of(scenario, time.monotonic())
    progress = Progress(scenario.fleet.name, quiet, watch.began_s)
    failures: list[str] = []
    with FleetProcesses.start(scenario, folder, offset) as fleet, progress:
        with FleetSession(scenario.fleet.name, endpoints, WAITING_OPERATOR) as session, ExitStack() as stack:
            targets = publish_targets(scenario, endpoints, watch.began_s, stack)

            def update() -> None:
                if ending := fleet.unexpected_end():  # the operator may have killed it to see how the others react
                    progress.remark(ending)
                targets.update(time.monotonic())

            director = Director(session, watch, progress, update, fleet.lost_vehicles, MachineClock())
            print(_how_to(scenario, folder, offset), flush=True)
            director.attend(lambda: stop.number is not None)
            session.command(set(ids) - fleet.lost_vehicles(), CommandName.TAKE, REPLY_WITHIN_S)
            if still_up := director.land_all():
                failures.append(still_up)
        lost = fleet.lost_vehicles()
        failures.extend(fleet.stop_all())
        failures.extend(left_armed(folder, lost))
    busy = watch.overload()
    return [*([overload_line(busy)] if busy else []), *failures], bool(failures)


def left_armed(folder: Path, lost: Iterable[int]) -> list[str]:
    """A line for each vehicle without an agent or stand-in that was armed to the end: nobody could land it."""
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
