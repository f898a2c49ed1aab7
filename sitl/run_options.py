"""The command line of `sitl run`, most of which `sitl fly` shares. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from companion.config.law import LawName
from companion.types import AutopilotKind

LAWS: tuple[LawName, ...] = get_args(LawName)


DESCRIPTION = """\
Fly a scenario in virtual time: the same agents and stand-in autopilots as `sitl fly`, in one loop without sockets, many times
faster than real time. The same scenario and seed give the same flight to the last bit.
"""

MORE = """\
examples:
  sitl run config/scenarios/platoon.yaml                        the paper's platoon with the paper's law
  sitl run config/scenarios/platoon.yaml --compare              all laws in turn, one table, one figure
  sitl run config/scenarios/platoon.yaml --set stand_in.sensors=default --set stand_in.seed=2
  sitl run config/scenarios/platoon.yaml --autopilot ardupilot  with ArduCopter's manners instead of PX4's
  sitl run config/scenarios/platoon.yaml --set links.peer_loss=0.1 --set links.peer_delay_s=0.1

--set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value. The section links says
how late and how surely telemetry, setpoints and peer packets come.

the folder (default: runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; the files of an older run
in it go):
  summary.json              as of `sitl fly`, and real_time_factor: seconds flown per second that it took to fly them. What
                            `sitl fly` times (tick, telemetry_to_command_us, cpu_percent, rss_mb) is null in virtual time
  figure_5.png, figure_6.png, from_above.png, comparison.json, comparison.png, scenario.yaml      as of `sitl fly`
  truth_N.csv               where vehicle N truly was, 50 times a second; its clock is virtual and begins at 0

Ctrl-C lands all vehicles, which takes no time here, and writes the folder; a second Ctrl-C stops at once.

exit codes:
  0    flown and landed
  1    the flight failed; the one line says which vehicle and why
  2    the scenario or an argument cannot be used; the one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
"""


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line says. `others` are the laws to compare with, None where nothing is to be compared."""

    scenario: Path
    overrides: Sequence[str] = ()
    others: Sequence[LawName] | None = None
    out: Path | None = None
    quiet: bool = False


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="a scenario file, see config/scenarios/")
    parser.add_argument("--law", choices=LAWS, help="fly with this law (short for --set fleet.law.name=LAW)")
    parser.add_argument(
        "--autopilot",
        choices=[str(kind) for kind in AutopilotKind],
        help="fly with stand-ins of these manners (short for --set stand_in.autopilot=AUTOPILOT)",
    )
    parser.add_argument(
        "--compare",
        nargs="*",
        choices=LAWS,
        metavar="LAW",
        help="fly with the scenario's law, then with these (default: with all others), and compare",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="change one key of the scenario; may be given many times",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")
    parser.add_argument("--quiet", action="store_true", help="print the result only")


def run_options(parsed: argparse.Namespace) -> RunOptions:
    """--law and --autopilot come first: a --set of the same key wins."""
    law = [f"fleet.law.name={parsed.law}"] if parsed.law else []
    autopilot = [f"stand_in.autopilot={parsed.autopilot}"] if parsed.autopilot else []
    others: Sequence[LawName] | None = parsed.compare
    if others is not None and not others:
        others = LAWS
    return RunOptions(parsed.scenario, [*law, *autopilot, *parsed.overrides], others, parsed.out, parsed.quiet)
