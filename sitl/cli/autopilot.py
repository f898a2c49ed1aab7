"""`sitl autopilot`: one stand-in quadrotor behind the sockets of this machine."""

from __future__ import annotations

import argparse
from math import inf
from pathlib import Path

from companion.types.autopilot import AutopilotKind
from sitl.cli.options import number, whole_number
from sitl.links.ports import MAX_PORT_OFFSET

HELP = "one stand-in quadrotor that behaves like PX4 or ArduCopter, behind UDP and TCP"
DESCRIPTION = "One stand-in quadrotor that behaves like PX4 or ArduCopter, behind sockets of this machine."
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

exit codes: 0 ended as asked, 2 bad file or port in use"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", help="YAML file: id, start_enu_m, stand_in, ...")
    parser.add_argument("--id", type=int, help="vehicle id (MAVLink system id), instead of the configured one")
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
    parser.add_argument("--truth", type=Path, metavar="CSV", help="write true states at 50 Hz")
    parser.add_argument(
        "--seconds",
        type=number("seconds above 0", lambda value: 0.0 < value < inf),
        metavar="S",
        help="end after S seconds",
    )


def run(parsed: argparse.Namespace) -> int:
    from sitl.autopilots.file import load_autopilot_file
    from sitl.autopilots.realtime import run_autopilot
    from sitl.links.ports import ports_of

    file = load_autopilot_file(parsed.config, parsed.id, parsed.autopilot)
    run_autopilot(file, ports_of(file.id, parsed.port_offset), parsed.truth, parsed.seconds)
    return 0
