"""A simulated fleet that waits for an operator: `sitl fleet`. Nothing is commanded here before its end."""

from __future__ import annotations

import time
from contextlib import ExitStack

from companion.ground.session import FleetSession
from companion.ground.target import TargetPublisher
from companion.types import CommandName, Role
from sitl.director import Director, MachineClock
from sitl.ending import EXIT_DONE, EXIT_FAILED
from sitl.fleet import Fleet, endpoint_of, ids_of
from sitl.flights import remove_old_run
from sitl.free_ports import check_ports
from sitl.moving_targets import MovingTargets
from sitl.orders import REPLY_WITHIN_S
from sitl.progress import Progress
from sitl.scenario import Scenario, load_scenario
from sitl.stopping import StopRequest
from sitl.waiting_options import WaitingOptions
from sitl.watch import FlightWatch

OPERATOR = "sitl-fleet"
HOW_TO = """\
fleet {name}, vehicles {ids}. In a second terminal, one after the other:
  companion fleet ready --fleet {file}{connect}
  companion fleet arm --fleet {file}{connect}        and likewise takeoff, form, ..., land: companion fleet --help
Ctrl-C here lands all and ends."""


def run_fleet(options: WaitingOptions) -> int:
    """The exit code. Raises what sitl/ending.py puts into words."""
    scenario = load_scenario(options.scenario, options.overrides)
    check_ports(ids_of(scenario), scenario.stand_in.autopilot, options.port_offset)
    remove_old_run(options.out)
    options.out.mkdir(parents=True, exist_ok=True)
    with StopRequest("stopped at once; nothing was landed") as stop:
        failures = _wait_and_land(scenario, options, stop)
    print("\n".join(failures) or f"all landed; files and logs in {options.out}")
    return EXIT_FAILED if failures else EXIT_DONE


def _wait_and_land(scenario: Scenario, options: WaitingOptions, stop: StopRequest) -> list[str]:
    """What went wrong, in one line each."""
    ids = ids_of(scenario)
    endpoints = [endpoint_of(vehicle_id, options.port_offset) for vehicle_id in ids]
    leader_ids = [member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER]
    watch = FlightWatch(ids, leader_ids, time.monotonic())
    progress = Progress(scenario.fleet.name, options.quiet, watch.began_s)
    failures: list[str] = []
    with Fleet.start(scenario, options.out, options.port_offset) as fleet:
        with FleetSession.open(scenario.fleet.name, endpoints, OPERATOR) as session, ExitStack() as voices:
            told = {
                target.name: voices.enter_context(TargetPublisher.open(scenario.fleet.name, endpoints, target.name))
                for target in scenario.targets
            }
            targets = MovingTargets(scenario.targets, lambda name, v, x: told[name].tell(v, x), watch.began_s)

            def go_on() -> None:
                if ending := fleet.unexpected_end():  # whoever killed it wants to see what the others do
                    progress.remark(ending)
                targets.go_on(time.monotonic())

            director = Director(session, watch, progress, go_on, fleet.lost_vehicles, MachineClock())
            print(_how_to(scenario, options, endpoints), flush=True)
            director.attend(lambda: stop.number is not None)
            session.command(set(ids) - fleet.lost_vehicles(), CommandName.TAKE, REPLY_WITHIN_S)
            if still_up := director.land_all():
                failures.append(still_up)
        if killed := fleet.stop():
            failures.append(f"{', '.join(killed)} did not end when told to and had to be killed")
    return failures


def _how_to(scenario: Scenario, options: WaitingOptions, endpoints: list[str]) -> str:
    connect = f" --connect {endpoints[0]}" if options.port_offset or len(endpoints) > 8 else ""
    ids = ", ".join(map(str, ids_of(scenario)))
    return HOW_TO.format(name=scenario.fleet.name, ids=ids, file=options.out / "fleet.yaml", connect=connect)
