"""`companion fleet use`: saves the current fleet, so that other commands need no --fleet and --connect."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

NAME = "use"
SUMMARY = "saves or shows the current fleet: a fleet file and endpoints"
DESCRIPTION = """\
Save a fleet file, endpoints and an identity as the current fleet; without FILE, show the current fleet and
where it comes from.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", nargs="?", type=Path, metavar="FILE", help="the fleet file of the vehicles")
    parser.add_argument(
        "--connect", nargs="+", action="extend", default=[], metavar="ENDPOINT", help="Zenoh endpoints of vehicles"
    )
    parser.add_argument("--identity", type=Path, metavar="DIR", help="folder of the own certificate")
    parser.add_argument("--clear", action="store_true", help="delete the saved current fleet")


def run(options: argparse.Namespace) -> int:
    """The exit code. Raises ConfigError and link.fleet.zenoh_session.EndpointError."""
    from companion.config.fleet_check import load_fleet
    from companion.ground.current_fleet import forget_current, save_current, select
    from companion.link.fleet.identity import load
    from companion.link.fleet.zenoh_session import check_endpoints

    if options.clear:
        forget_current(os.environ)
    elif options.file:
        load_fleet(options.file)
        check_endpoints("connect", options.connect)
        if options.identity:
            load(options.identity)
        print(f"saved in {save_current(options.file, options.connect, options.identity, os.environ)}")
    print(select(None, (), None, os.environ))
    return 0
