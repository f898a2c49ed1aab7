"""`companion monitor`: the command line of the live page of a fleet, and of its table in the terminal."""

from __future__ import annotations

import argparse
import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from companion import GROUND_INSTALL
from companion.cli.options import add_identity
from companion.cli.program import command
from companion.types.errors import EXIT_DONE, RefusedCommandError

if TYPE_CHECKING:
    from companion.config.fleet import FleetConfig
    from companion.ground.current_fleet import Selection
    from companion.security.identity import Identity

LISTEN = "127.0.0.1:8600"
# Options of the live page alone, with what they are without one
OF_PAGE = {"listen": LISTEN, "control": False, "mavlink": None, "replay": None, "record": None, "tiles": None}
SIMULATED_VEHICLES = range(1, 9)  # by default


def _add_monitor(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--fleet", default="*", metavar="NAME", help="only this fleet (default: every fleet)")
    parser.add_argument("--fleet-file", type=Path, metavar="FILE", help="the fleet file (default: the current fleet)")
    parser.add_argument(
        "--connect",
        nargs="+",
        action="extend",
        metavar="ENDPOINT",
        help="Zenoh endpoints of vehicles (default: COMPANION_CONNECT, else those or the addresses of the fleet file,"
        " else tcp/127.0.0.1:7448 to 7455, vehicles 1 to 8 of a simulation)",
    )
    add_identity(parser)
    page = parser.add_argument_group("live page")
    page.add_argument(
        "--listen",
        default=LISTEN,
        metavar="ADDRESS:PORT",
        help="where the page is served (default 127.0.0.1:8600); port 0 chooses a free one",
    )
    page.add_argument("--control", action="store_true", help="accept commands from the page; the URL has a token")
    page.add_argument(
        "--mavlink",
        metavar="udpout:HOST:PORT",
        help="also send the whole fleet, read-only, to a QGroundControl at this address",
    )
    page.add_argument(
        "--replay", type=Path, metavar="FOLDER", help="show the recorded flight in this folder, with a time slider"
    )
    page.add_argument("--record", type=Path, metavar="FOLDER", help="record all statuses and the commands of this page")
    page.add_argument(
        "--tiles",
        type=Path,
        metavar="PATH",
        help="map tiles below the map: a folder with Z/X/Y.png, or an MBTiles file",
    )
    terminal = parser.add_argument_group("terminal")
    terminal.add_argument("--tui", action="store_true", help="the table in the terminal instead of the page")
    terminal.add_argument("--once", action="store_true", help="print one table after at most 3 s and end")
    terminal.add_argument("--json", action="store_true", help="one JSON array per table instead of the table")


def _run_monitor(options: argparse.Namespace) -> int:
    """Show every vehicle of a fleet, from Zenoh alone. Prints one URL: the live page has a map, the
    vehicles, alarms, plots and a timeline, and works without the internet. --tui shows the essentials
    in the terminal instead. A vehicle without a report for one second is SILENT and stays.

    examples:
      companion monitor                                          the current fleet, or a simulation
      companion monitor --control                                and commands from the page
      companion monitor --connect tls/192.168.1.11:7447 --identity identity      one vehicle of a real fleet
      companion monitor --fleet-file fleet.yaml --tiles field.mbtiles    with fence, slots and a local map
      companion monitor --listen 0.0.0.0:8600                    for the tablets in this network
      companion monitor --mavlink udpout:127.0.0.1:14550         and in QGroundControl
      companion monitor --replay flights/2026-05-03              a recorded flight
      companion monitor --tui                                    over ssh
      companion monitor --once --json | jq '.[].error_to_slot_m'

    The page needs no file of a fleet to show its vehicles; with it, it also shows fence, obstacles,
    slots and the figures of the law. The fleet file is --fleet-file, else COMPANION_FLEET, else the
    current fleet (companion fleet use). Each endpoint reaches one vehicle; those of all vehicles come
    from the addresses in the fleet file. A fleet with identities needs that of a ground or of a
    monitor, and for --control that of a ground.

    Without --control nothing can be sent. With it the URL has a token: who has the URL commands the
    fleet. Only this machine reaches the default address; the connection is not encrypted, so use it
    over other networks through ssh -L 8600:127.0.0.1:8600, or a VPN.

    docs/api.md has the interface for programs: JSON, WebSocket, /metrics for Prometheus.
    docs/monitor-interfaces.md has the terminal's columns, and what QGroundControl is sent.

    --tui on terminals of 80, 120 and 200 columns shows more the wider they are; into a pipe or a file
    it is printed once a second. --once prints it one time.

    exit codes:
      0  ended by Ctrl-C, or --once received at least one report
      1  --once received no report for 3 s
      2  an argument cannot be used, the address is in use, or a package is missing
    """

    in_terminal = options.tui or options.once or options.json
    given = [f"--{name}" for name, default in OF_PAGE.items() if getattr(options, name) != default]
    if in_terminal and given:
        reason = f"{', '.join(given)}: only for the live page; leave --tui, --once and --json out"
        raise RefusedCommandError(reason)
    try:
        return _run_terminal(options) if in_terminal else _run_page(options)
    except KeyboardInterrupt:  # the usual end, here before anything is shown
        return EXIT_DONE


def _select(
    options: argparse.Namespace,
) -> tuple[Selection, FleetConfig | None, Identity | None, tuple[str, ...]]:
    """Fleet file, identity and endpoints. No endpoints: a simulation is guessed. Raises ConfigError."""
    from companion.config.fleet_check import load_fleet
    from companion.config.vehicle import ground_endpoints
    from companion.ground.current_fleet import Selection, select
    from companion.link.fleet.identity import load

    if options.replay and not options.fleet_file:  # a flight has the fleet file that it was flown with
        return Selection(None, "", (), "", None), None, None, ()
    selection = select(options.fleet_file, options.connect or (), options.identity, os.environ)
    identity = load(selection.identity) if selection.identity else None
    fleet = load_fleet(selection.fleet) if selection.fleet else None
    addresses = ground_endpoints(fleet, identity is not None) if fleet else ()
    return selection, fleet, identity, selection.connect or addresses


def _simulation(fleet: FleetConfig | None) -> tuple[str, ...]:
    from companion.ground.current_fleet import simulation_endpoints

    return simulation_endpoints([member.id for member in fleet.vehicles] if fleet else SIMULATED_VEHICLES)


def _run_terminal(options: argparse.Namespace) -> int:
    from companion.monitor.tui import run_monitor

    _, fleet, identity, endpoints = _select(options)
    return run_monitor(
        options.fleet,
        endpoints or _simulation(fleet),
        identity,
        once=options.once,
        as_json=options.json,
        endpoints_are_guessed=not endpoints,
        fleets={fleet.name: fleet} if fleet else {},
    )


def _run_page(options: argparse.Namespace) -> int:
    if not find_spec("aiohttp"):
        needed = f"the live page needs the package aiohttp: {GROUND_INSTALL}, or use --tui"
        raise RefusedCommandError(needed)
    from companion.monitor.live_page import LivePage, run_live_page

    selection, fleet, identity, endpoints = _select(options)
    run_live_page(
        LivePage(
            fleet_name=options.fleet,
            fleet=fleet,
            fleet_file=selection.fleet,
            endpoints=endpoints or _simulation(fleet),
            endpoints_are_guessed=not endpoints,
            identity=identity,
            listen=options.listen,
            control=options.control,
            tiles=options.tiles,
            mavlink=options.mavlink,
            record=options.record,
            replay=options.replay,
        )
    )
    return EXIT_DONE


MONITOR = command(
    "monitor", "shows a fleet live: a page for the browser, or a table in the terminal", _add_monitor, _run_monitor
)
