"""`companion init`: the command line that writes the files of real vehicles."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.new_formation import TOPOLOGIES, add_formation, formation_of
from companion.cli.options import fail
from companion.types.autopilot import AutopilotKind

NAME = "init"
SUMMARY = "writes the fleet file and the vehicle files of real vehicles"
EXIT_WRITTEN, EXIT_REFUSED = 0, 2
DESCRIPTION = """\
Write the files of N real vehicles into DIR: fleet.yaml, which all of them share, and vehicle-1.yaml
to vehicle-N.yaml with the endpoint of the autopilot, the hover thrust, and the reference for the
vehicles that may lead. All files are commented and agree with each other.
Existing files are not overwritten.
"""

MORE = f"""\
examples:
  companion init field --vehicles 2 --origin 47.3977 8.5456 488
  companion init field --vehicles 3 --shape v --may-lead 2 --origin indoor \\
      --address 10.0.0.5 10.0.0.7 10.0.0.9
  companion init bench --vehicles 4 --origin 47.3977 8.5456 488 --address 127.0.0.1:{{id+7447}} \\
      --mavlink udpin:127.0.0.1:{{id+14539}}

--address and --mavlink take one value for each vehicle, or one pattern for all: {{id}} is the vehicle
id, {{id+10}} is ten more.

{TOPOLOGIES}

exit codes:
  0  written; the last lines are the commands to go on with
  2  an argument cannot be used, or a file exists
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
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


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.assembly import flyable_problems
    from companion.config.file import ConfigError
    from companion.config.new_fleet import NewFleet, new_fleet, origin_of
    from companion.mavlink.autopilot_types import PROFILES

    try:
        choices = NewFleet(
            formation=formation_of(options, options.name),
            origin=origin_of(options.origin),
            addresses=options.address,
            mavlink=options.mavlink,
            hover_thrust_norm=options.hover_thrust,
            autopilot=options.autopilot,
            security=options.security,
            hover_parameters={kind: profile.hover_parameter for kind, profile in PROFILES.items()},
        )
        print(new_fleet(choices, options.folder, flyable_problems), end="")
    except ConfigError as error:
        return fail(str(error), EXIT_REFUSED)
    return EXIT_WRITTEN
