"""What is needed before a flight: `sitl scenarios`, `sitl new` for a first scenario, and `sitl autopilot` for stand-ins."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.init import add_formation, formation_of, with_topologies
from companion.cli.options import number, whole_number
from companion.cli.program import command
from companion.config.file import ConfigError
from companion.types.autopilot import AutopilotKind
from sitl.cli.options import ABOVE_0, BELOW_INFINITY
from sitl.links.ports import MAX_PORT_OFFSET


def _add_autopilot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--config", type=Path, nargs="+", metavar="FILE", help="a YAML file per vehicle: id, start_enu_m, stand_in, ..."
    )
    parser.add_argument(
        "--id", type=int, help="vehicle id (MAVLink system id), instead of the configured one; for one vehicle"
    )
    parser.add_argument(
        "--autopilot",
        type=AutopilotKind,
        choices=list(AutopilotKind),
        help="the autopilot that it imitates, instead of the configured one (default px4)",
    )
    parser.add_argument(
        "--port-offset",
        type=whole_number(0, MAX_PORT_OFFSET),
        default=0,
        metavar="K",
        help="added to all ports (default 0)",
    )
    parser.add_argument(
        "--truth", type=Path, nargs="+", metavar="CSV", help="write true states at 50 Hz, a file per vehicle"
    )
    parser.add_argument(
        "--seconds", type=number("seconds above 0", ABOVE_0, BELOW_INFINITY), metavar="S", help="end after S seconds"
    )


def _run_autopilot(options: argparse.Namespace) -> int:
    """Stand-in quadrotors that behave like PX4 or ArduCopter, behind sockets of this machine; one per FILE.

    With id N (instance i = N - 1, K the port offset) it listens for a companion on UDP 14580+i+K and sends to 14540+i+K; for a
    ground station it listens on 18570+i+K and sends to 14550. As ArduCopter it also listens on TCP 5760+10i+K, for one client
    at a time. It can be armed about 4 s after its start, as ArduCopter after 42 s, as measured with the real ones;
    stand_in.armable_after_s in the file changes that.

    examples:
      sitl autopilot                                        vehicle 1 with the default airframe and sensor noise
      sitl autopilot --autopilot ardupilot                  the same as ArduCopter
      sitl autopilot --id 3 --truth truth.csv               vehicle 3; its true states are written at 50 Hz
      sitl autopilot --config autopilot.yaml --seconds 60   as configured, for a minute
      sitl autopilot --config a.yaml b.yaml c.yaml          three vehicles in one process, which costs far less than three

    exit codes: 0 ended as asked, 2 bad file or port in use
    """

    from sitl.autopilots.types import load_autopilot_files
    from sitl.links.ports import ports_of
    from sitl.links.realtime import ServedStandIn, run_autopilots

    files = load_autopilot_files(options.config, options.id, options.autopilot)
    truths = options.truth or [None] * len(files)
    if len(truths) != len(files):
        raise ConfigError("--truth", "", f"{len(truths)} files for {len(files)} vehicles: expected one for each")
    ports = [ports_of(file.id, options.port_offset) for file in files]
    run_autopilots([ServedStandIn(*one) for one in zip(files, ports, truths, strict=True)], options.seconds)
    return 0


def _add_new(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="name of the file and of the fleet")
    add_formation(parser)
    parser.add_argument("--folder", type=Path, default=Path(), metavar="DIR", help="where to write it (default: here)")


def _run_new(options: argparse.Namespace) -> int:
    """Write a commented scenario file NAME.yaml that flies as it is: vehicles with their slots, neighbours,
    law, reference, fence and timeline. The pace of the reference and the fence fit the formation. An
    existing file is not overwritten.

    examples:
      sitl new v_on_circle --vehicles 5 --shape v --spacing 3 --reference circle
      sitl new eight --vehicles 6 --shape column --topology double --reference figure_8 --heading course
      sitl new gather --vehicles 4 --shape circle --topology range --folder scenarios

    TOPOLOGIES

    exit codes:
      0  written; the last lines are the commands to go on with
      2  an argument cannot be used, or the file exists
    """

    from sitl.flight.new_scenario import new_scenario

    print(new_scenario(formation_of(options), options.folder), end="")
    return 0


def _run_scenarios(_: argparse.Namespace) -> int:
    """The scenarios that are installed with the program: name, vehicles, law and what each shows. Every command that takes a
    scenario takes such a name.

    examples:
      sitl scenarios
      sitl run platoon

    exit codes: 0 listed
    """

    from companion.config.shipped import shipped_lines

    print("\n".join(shipped_lines()))
    return 0


SCENARIOS = command(
    "scenarios", "lists the shipped scenarios, which fly by their names", lambda _: None, _run_scenarios
)


AUTOPILOT = command(
    "autopilot",
    "stand-in quadrotors that behave like PX4 or ArduCopter, behind UDP and TCP",
    _add_autopilot,
    _run_autopilot,
    after="With id N",
)


NEW = with_topologies(command("new", "writes a commented scenario file from a few choices", _add_new, _run_new))
