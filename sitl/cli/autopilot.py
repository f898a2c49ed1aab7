"""`sitl autopilot`: stand-in quadrotors behind the sockets of this machine."""

from __future__ import annotations

import argparse
from math import inf
from pathlib import Path

from companion.config.file import ConfigError
from companion.types.autopilot import AutopilotKind
from sitl.cli.options import number, whole_number
from sitl.links.ports import MAX_PORT_OFFSET

HELP = "stand-in quadrotors that behave like PX4 or ArduCopter, behind UDP and TCP"
DESCRIPTION = "Stand-in quadrotors that behave like PX4 or ArduCopter, behind sockets of this machine; one per FILE."
MORE = """\
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

exit codes: 0 ended as asked, 2 bad file or port in use"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
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
        "--seconds",
        type=number("seconds above 0", lambda value: 0.0 < value < inf),
        metavar="S",
        help="end after S seconds",
    )


def run(parsed: argparse.Namespace) -> int:
    from sitl.autopilots.types import load_autopilot_files
    from sitl.links.ports import ports_of
    from sitl.links.realtime import ServedStandIn, run_autopilots

    files = load_autopilot_files(parsed.config, parsed.id, parsed.autopilot)
    truths = parsed.truth or [None] * len(files)
    if len(truths) != len(files):
        raise ConfigError("--truth", "", f"{len(truths)} files for {len(files)} vehicles: expected one for each")
    ports = [ports_of(file.id, parsed.port_offset) for file in files]
    run_autopilots([ServedStandIn(*one) for one in zip(files, ports, truths, strict=True)], parsed.seconds)
    return 0
