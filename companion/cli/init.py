"""`companion init`: the files of real vehicles; and the options of a new formation, which `sitl new` shares."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import get_args

import msgspec

from companion.cli.program import CliCommand, command
from companion.config.law import BUILT_IN
from companion.config.new_formation import NewFormation
from companion.config.planned_flight import TOPOLOGY_WORDS, ShapeName, Topology
from companion.config.reference import FirstKind
from companion.types.autopilot import AutopilotKind
from companion.types.errors import EXIT_DONE

TOPOLOGIES = "topologies:\n" + "\n".join(f"  {name:<8} {words}" for name, words in TOPOLOGY_WORDS.items())


def with_topologies(made: CliCommand) -> CliCommand:
    """The command, whose help lists the topologies where the docstring has a line TOPOLOGIES."""
    return replace(made, more=made.more.replace("TOPOLOGIES\n", f"{TOPOLOGIES}\n"))


def add_formation(parser: argparse.ArgumentParser) -> None:
    """The choices of a formation. Their defaults are those of NewFormation."""
    parser.add_argument("--vehicles", type=int, required=True, metavar="N", help="number of vehicles; vehicle 1 leads")
    parser.add_argument("--shape", choices=get_args(ShapeName), default="line", help="shape (default line)")
    parser.add_argument(
        "--spacing",
        dest="spacing_m",
        type=float,
        default=3.0,
        metavar="M",
        help="smallest distance between slots (default 3)",
    )
    parser.add_argument("--topology", choices=get_args(Topology), default="chain", help="neighbours (default chain)")
    parser.add_argument("--reference", choices=get_args(FirstKind), default="point", help="reference (default point)")
    parser.add_argument("--law", choices=BUILT_IN, default="cooperative", help="law (default cooperative)")
    parser.add_argument(
        "--heading",
        choices=("fixed", "course"),
        default="fixed",
        help="fixed: the formation points east; course: it turns with the reference (default fixed)",
    )
    parser.add_argument(
        "--height", dest="height_m", type=float, default=3.0, metavar="M", help="height of the flight (default 3)"
    )
    parser.add_argument(
        "--may-lead", type=int, nargs="+", default=[], metavar="ID", help="followers that can become leader"
    )


def formation_of(parsed: argparse.Namespace) -> NewFormation:
    """The choices of the command line, which have the names of the fields."""
    may_lead = tuple(dict.fromkeys(parsed.may_lead))
    return msgspec.convert({**vars(parsed), "may_lead": may_lead}, NewFormation)


def _add_init(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="DIR", help="where to write the files; it is created")
    parser.add_argument("--name", default="fleet", help="name of the fleet on the network (default fleet)")
    parser.add_argument(
        "--origin",
        nargs="+",
        required=True,
        metavar="WHERE",
        help="zero of the fleet frame: latitude and longitude in degrees, altitude above mean sea level in metres;"
        " or indoor (motion capture)",
    )
    add_formation(parser)
    parser.add_argument(
        "--address",
        nargs="+",
        default=["192.168.10.{id+10}"],
        metavar="HOST[:PORT]",
        help="addresses of the vehicles in their network (default 192.168.10.{id+10}, port 7447)",
    )
    parser.add_argument(
        "--mavlink",
        nargs="+",
        default=["serial:/dev/ttyAMA0:921600"],
        metavar="ENDPOINT",
        help="MAVLink endpoints of the autopilots (default serial:/dev/ttyAMA0:921600)",
    )
    parser.add_argument(
        "--security",
        choices=["none"],
        help="without identities: all who reach the network of the fleet can command it (default: identities, which"
        " companion provision makes, for addresses that other machines reach)",
    )
    parser.add_argument(
        "--autopilot", type=AutopilotKind, choices=list(AutopilotKind), help="accept no other autopilot"
    )
    parser.add_argument(
        "--hover-thrust", type=float, default=0.5, metavar="T", help="initial hover thrust, 0.1 to 0.9 (default 0.5)"
    )


def _run_init(options: argparse.Namespace) -> int:
    """Write the files of N real vehicles into DIR: fleet.yaml, which all of them share, and vehicle-1.yaml
    to vehicle-N.yaml with the endpoint of the autopilot, the hover thrust, and the reference for the
    vehicles that may lead. All files are commented and agree with each other.
    Existing files are not overwritten.

    examples:
      companion init field --vehicles 2 --origin 47.3977 8.5456 488
      companion init field --vehicles 3 --shape v --may-lead 2 --origin indoor \\
          --address 10.0.0.5 10.0.0.7 10.0.0.9
      companion init bench --vehicles 4 --origin 47.3977 8.5456 488 --address 127.0.0.1:{id+7447} \\
          --mavlink udpin:127.0.0.1:{id+14539}

    --address and --mavlink take one value for each vehicle, or one pattern for all: {id} is the vehicle
    id, {id+10} is ten more.

    TOPOLOGIES

    exit codes:
      0  written; the last lines are the commands to go on with
      2  an argument cannot be used, or a file exists
    """

    from companion.assembly import flyable_problems
    from companion.config.new_fleet import NewFleet, new_fleet, origin_of
    from companion.mavlink.autopilot_types import PROFILES

    choices = NewFleet(
        formation=formation_of(options),
        origin=origin_of(options.origin),
        addresses=options.address,
        mavlink=options.mavlink,
        hover_thrust_norm=options.hover_thrust,
        autopilot=options.autopilot,
        security=options.security,
        hover_parameters={kind: profile.hover_parameter for kind, profile in PROFILES.items()},
    )
    print(new_fleet(choices, options.folder, flyable_problems), end="")
    return EXIT_DONE


INIT = with_topologies(
    command("init", "writes the fleet file and the vehicle files of real vehicles", _add_init, _run_init)
)
