"""`companion mocap`: poses of a motion-capture system for the vehicles, and the guided check of its axes."""

from __future__ import annotations

import argparse
import os
import signal
from pathlib import Path

from companion.cli.options import add_identity
from companion.cli.program import command
from companion.types.errors import EXIT_DONE


def _add_mocap(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION", title="actions")
    run = actions.add_parser("run", help="publishes the poses of the bodies until Ctrl-C")
    check = actions.add_parser(
        "check", help="asks for one motion after another, and says what is wrong with axes and names"
    )
    for one in (run, check):
        one.add_argument("file", type=Path, metavar="FILE", help="the camera system, its axes and its bodies (YAML)")
    run.add_argument(
        "--connect",
        nargs="+",
        action="extend",
        default=[],
        metavar="ENDPOINT",
        help="Zenoh endpoints of vehicles (default: COMPANION_CONNECT, else the addresses of the fleet file, else those of a"
        " simulation)",
    )
    add_identity(run)


def _run_mocap(options: argparse.Namespace) -> int:
    """Read the rigid bodies of a camera system and publish them to the vehicles as poses in the fleet frame. The vehicles
    pass them on to their autopilots in place of GPS: origin: indoor in the fleet file. Nothing else is sent.

    examples:
      companion mocap check lab.yaml                                      first: are axes and names right?
      companion mocap run lab.yaml
      companion mocap run lab.yaml --identity ground/mocap-ceiling        vehicles with identities
      companion mocap run lab.yaml --connect tcp/192.168.1.11:7447        this vehicle alone

    a file, here of OptiTrack with its usual axes, y up:
      fleet: fleet.yaml                relative to this file
      system: natnet                   or optitrack, vicon, qualisys, vrpn
      host: 192.168.1.5                the computer of the camera system
      up: y                            y or z: the axis of the capture frame that points up
      forward: x                       its axis that points to the fleet's x, east: x, -x, y, -y, z or -z
      turn_deg: 0                      angle from east to forward, counterclockwise, where the frame stands askew
      bodies: {cf1: 1, cf2: 2}         name of the rigid body: vehicle id
      rate_hz: 100                     at most so many poses per second; without it each frame
      latency_s: 0.01                  age of a frame, where the system does not say it: all but natnet

    natnet reads OptiTrack on every machine. The others need the library motioncapture, which exists for amd64 alone. Where
    one is missing, `companion mocap` says how this installation gets it.

    Make each rigid body while the vehicle stands level, with its nose along forward: the body then has the axes of the
    frame. `check` says what it sees, as "moved 1.02 m to the west; expected east: set forward: -x". The first body is moved
    east, lifted and turned to the left; each other one is lifted, which shows that its name is right.

    A body that is not tracked is not published; it is named after 0.2 s, and every 10 s. So are bodies that are not in
    the file, and poses that are none. Where no frame arrives for 0.5 s, a line says so; after 10 s it connects again, and goes
    on so until frames arrive. A line says what is published, every 10 s and when bodies change.

    exit codes:
      0  ended by Ctrl-C; with check: axes and names are right
      1  the camera system does not answer; with check: something is wrong
      2  a file or an argument cannot be used, or a library is missing
    """

    from companion.ground.mocap.command import check_mocap, run_mocap

    if options.action == "check":
        return check_mocap(options.file)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        run_mocap(options.file, tuple(options.connect), options.identity, os.environ)
    except KeyboardInterrupt:
        return EXIT_DONE


MOCAP = command("mocap", "publishes poses of a motion-capture system to the vehicles", _add_mocap, _run_mocap)
