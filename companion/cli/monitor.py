"""`companion monitor`: the command line of the live table of a fleet."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from companion.cli.options import add_identity, fail

NAME = "monitor"
SUMMARY = "shows the state of a fleet in the terminal"
EXIT_ENDED, EXIT_UNUSABLE = 0, 2
SIMULATED_VEHICLES = range(1, 9)  # by default
DESCRIPTION = """\
Show every vehicle of a fleet, from Zenoh alone: phase, mode, battery, position, error to its
slot, age of its data, and below the table its health flags or its last event. A vehicle without a
report for one second is SILENT and stays in the table.
"""

MORE = """\
examples:
  companion monitor                                          the current fleet, or a simulation
  companion monitor --connect tls/192.168.1.11:7447 --identity identity      one vehicle of a real fleet
  companion monitor --fleet platoon --once                   one table, for scripts
  companion monitor --once --json | jq '.[].error_to_slot_m'

Each endpoint reaches one vehicle; those of all vehicles come from the addresses in the fleet file.
A fleet with identities needs that of a ground or of a monitor. On a terminal the table is live;
into a pipe or a file it is printed once a second.

columns, on terminals of 80 columns and more:
  position   east, north, up of the origin of the fleet, metres
  error      metres from its position in the formation; - where it does not fly or no leader reports
  data       age of its position, with the transmission to here
of 100 columns and more:
  PrC        priority coefficient: 1 is a leader, 2 has a leader as neighbour, 3 has a 2, and so on
  formation  the number of the flown formation
of 120 columns and more:
  reference  the number of the flown reference
  rej        messages that the vehicle has rejected so far
of 150 columns and more:
  operator   holds command
  hover      estimated hover thrust
  push       estimated disturbance
A missing leader is a warning from the end of the first takeoff on.

exit codes:
  0  ended by Ctrl-C, or --once received at least one report
  1  --once received no report for 3 s
  2  an argument cannot be used, or the package of the live table is missing
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fleet", default="*", metavar="NAME", help="only this fleet (default: every fleet)")
    parser.add_argument(
        "--connect",
        nargs="+",
        action="extend",
        metavar="ENDPOINT",
        help="Zenoh endpoints of vehicles (default: COMPANION_CONNECT, else those or the addresses of the current fleet,"
        " else tcp/127.0.0.1:7448 to 7455, vehicles 1 to 8 of a simulation)",
    )
    add_identity(parser)
    parser.add_argument("--once", action="store_true", help="print one table after at most 3 s and end")
    parser.add_argument("--json", action="store_true", help="one JSON array per table instead of the table")


def _addresses(fleet: Path | None, secured: bool) -> tuple[str, ...]:
    """Of the current fleet. Raises ConfigError."""
    from companion.config.fleet_check import load_fleet
    from companion.config.network import ground_endpoints

    return ground_endpoints(load_fleet(fleet), secured) if fleet else ()


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.config.file import ConfigError
    from companion.ground.current_fleet import select, simulation_endpoints
    from companion.ground.monitor import MonitorError, run_monitor
    from companion.link.own_identity import load
    from companion.link.zenoh_session import EndpointError

    try:
        selection = select(None, options.connect or (), options.identity, os.environ)
        identity = load(selection.identity) if selection.identity else None
        endpoints = selection.connect or _addresses(selection.fleet, identity is not None)
        endpoints = endpoints or simulation_endpoints(SIMULATED_VEHICLES)
        return run_monitor(options.fleet, endpoints, identity, once=options.once, as_json=options.json)
    except EndpointError as error:
        return fail(f'companion monitor: --connect "{error.endpoint}": {error}', EXIT_UNUSABLE)
    except ConfigError as error:
        return fail(str(error), EXIT_UNUSABLE)
    except MonitorError as error:
        return fail(f"companion monitor: {error}", EXIT_UNUSABLE)
    except KeyboardInterrupt:  # the usual end, here before the table is shown
        return EXIT_ENDED
