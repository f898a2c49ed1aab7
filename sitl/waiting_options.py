"""The command line of `sitl fleet`. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from companion.types import AutopilotKind
from sitl.fly_options import port_offset

DESCRIPTION = """\
A scenario's fleet as real processes, one stand-in autopilot and one agent per vehicle, that stands on the ground and waits for
an operator: `companion fleet` in a second terminal. The scenario's timeline is not flown; targets that it has move.
"""

MORE = """\
examples:
  sitl fleet config/scenarios/ring_figure_8.yaml
  sitl fleet config/scenarios/formations.yaml --set stand_in.sensors=ideal
  sitl fleet config/scenarios/platoon.yaml --autopilot ardupilot --port-offset 100

the folder (default: runs/fleet-SCENARIO; the files of an older run in it go):
  fleet.yaml                     what `companion fleet --fleet` takes; vehicle_N.yaml, autopilot_N.yaml, scenario.yaml
  truth_N.csv                    where vehicle N truly was, 50 times a second
  agent_N.log, autopilot_N.log   what the processes said: every command and its answer is a line of agent_N.log

Ctrl-C takes command, lands all vehicles where they are and stops everything; a second Ctrl-C stops at once.

exit codes:
  0    ended by Ctrl-C, all vehicles landed
  1    a vehicle could not be landed, or a process not be ended; the one line says which and why, the logs say more
  2    the scenario, an argument or a port cannot be used; the one line says which and what to do
"""


@dataclass(frozen=True, slots=True)
class WaitingOptions:
    scenario: Path
    overrides: Sequence[str]
    out: Path
    quiet: bool
    port_offset: int


def add_waiting_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="a scenario file, see config/scenarios/")
    parser.add_argument(
        "--autopilot",
        choices=[str(kind) for kind in AutopilotKind],
        help="stand-ins of these manners (short for --set stand_in.autopilot=AUTOPILOT)",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="change one key of the scenario; may be given many times",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for files and logs")
    parser.add_argument("--quiet", action="store_true", help="show no vehicles, only how to command them")
    parser.add_argument(
        "--port-offset",
        type=port_offset,
        default=0,
        metavar="N",
        help="move all ports by N, so that two fleets can fly on one machine",
    )


def waiting_options(parsed: argparse.Namespace) -> WaitingOptions:
    """--autopilot comes first: a --set of the same key wins."""
    autopilot = [f"stand_in.autopilot={parsed.autopilot}"] if parsed.autopilot else []
    out = parsed.out or Path("runs") / f"fleet-{parsed.scenario.stem}"
    return WaitingOptions(parsed.scenario, [*autopilot, *parsed.overrides], out, parsed.quiet, parsed.port_offset)
