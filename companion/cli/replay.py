"""`companion replay`: the command line of the replay of recorded flights."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.options import add_overrides, fail, vehicle_id

NAME = "replay"
SUMMARY = "feeds recorded inputs to the agent again and compares its commands"
EXIT_UNUSABLE, EXIT_INTERRUPTED = 2, 130
LAWS = ("cooperative", "weighted", "average_22", "average_26")
DESCRIPTION = """\
Replay the recordings of a flight: feed every recorded input to the same agent again, with the
configuration in the recording, and compare each output bit for bit: setpoint, requests, peer
packet, status, replies and events. With --law or --set, show instead what other settings would
have commanded in the same situations.
"""

MORE = """\
examples:
  companion replay flights/2026-05-03
  companion replay flights/2026-05-03 --vehicle 2 --json | jq '.vehicles[0].difference'
  companion replay flights/2026-05-03 --law average_22
  companion replay flights/2026-05-03 --set fleet.law.gains.position_1_s2=0.8 --csv commands.csv

FOLDER is searched for files *.mcap, also in folders inside; a single file is possible. The replay
of a vehicle begins with the start of its agent: without the first part of a recording it is
refused, and at a tick that is not recorded it ends.

--set takes any key of the fleet file (fleet.KEY) or the vehicle file (vehicle.KEY), [N] for the
N-th item of a list from 0, and a YAML value. The inputs stay those of the flight: the vehicle does
not fly by the other commands. So the differences show how the settings judge the same situation,
not the flight that they would give.

exit codes:
  0    every output is the recorded one; with --law or --set: compared
  1    an output differs; the first difference of each vehicle is printed
  2    a recording, a part of it or an argument cannot be used
  130  ended by Ctrl-C
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="the folder with the recordings of a flight")
    parser.add_argument("--vehicle", type=vehicle_id, metavar="N", help="only this vehicle (default: all)")
    parser.add_argument("--law", choices=LAWS, help="compare with this law (short for --set fleet.law.name=LAW)")
    add_overrides(parser, "compare with another value of one key of the fleet or vehicle file")
    parser.add_argument(
        "--csv", type=Path, metavar="FILE", help="with --law or --set: the commands of every tick, recorded and other"
    )
    parser.add_argument("--json", action="store_true", help="one JSON object instead of the text")


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.replay.command import ReplayOptions, run_replay
    from companion.types.errors import UnusableError

    overrides = [*([f"fleet.law.name={options.law}"] if options.law else []), *options.overrides]
    if options.csv and not overrides:
        return fail("companion replay: --csv: needs --law or --set; without them the commands are equal", EXIT_UNUSABLE)
    try:
        return run_replay(ReplayOptions(options.folder, options.vehicle, overrides, options.csv, options.json))
    except UnusableError as error:
        return fail(str(error), EXIT_UNUSABLE)
    except KeyboardInterrupt:
        return fail("interrupted", EXIT_INTERRUPTED)
