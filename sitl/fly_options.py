"""The command line of `sitl fly`. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from companion.config_file import ConfigError
from sitl.run_options import RunOptions, add_run_arguments, run_options

MAX_PORT_OFFSET = 40_000

DESCRIPTION = """\
Fly a scenario with real processes: one stand-in autopilot and one agent per vehicle, MAVLink between them, Zenoh between
the agents. Shows every vehicle live, lands, and leaves a folder with figures, plots, files and logs. With --external the
agents fly vehicles that something else has started, like PX4's and ArduPilot's own simulations.
"""

MORE = """\
examples:
  sitl fly config/scenarios/platoon.yaml                        the paper's platoon with the paper's law
  sitl fly config/scenarios/platoon.yaml --law average_22       with another law
  sitl fly config/scenarios/platoon.yaml --compare              all laws in turn, one table, one figure
  sitl fly config/scenarios/platoon.yaml --compare average_26   only these two
  sitl fly config/scenarios/platoon.yaml --autopilot ardupilot  with ArduCopter's manners instead of PX4's
  sitl fly config/scenarios/four_in_line.yaml --external config/external/px4_sih.yaml   four PX4 in their own simulation
  sitl fly config/scenarios/platoon.yaml --set stand_in.sensors=default --set timeline[3].for_s=20
  sitl fly config/scenarios/platoon.yaml --set stand_in.airframe.attitude=instant \\
                                         --set stand_in.airframe.motor_lag_s=0
  sitl fly runs/platoon-weighted-20250131-120000/scenario.yaml  once more, exactly as it was flown

--set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value.

the folder (default: runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; the files of an older run
in it go):
  summary.json                   largest, smallest and final distances, settling time, final error, timing of each agent
  figure_5.png, figure_6.png     x and y curves, inter-distances; all from true positions
  from_above.png                 the paths from above, with who led and who heeded whom after each command
  comparison.json, .png          with --compare
  scenario.yaml                  as flown; fleet.yaml, vehicle_N.yaml, autopilot_N.yaml are made from it
  truth_N.csv                    where vehicle N truly was, 50 times a second
  agent_N.log, autopilot_N.log   what the processes said

--external FILE flies the same scenario with agents alone: FILE says for each vehicle where its autopilot is reached and what
its hover thrust and drag are (see config/external/ and docs/external.md). Nothing is asked of a vehicle before all are ready:
the autopilots' own checks pass, origin and position are known, parameters are in order, and each stands within 10 m of its
starts_enu_m, by fleet.origin, and not where another one does. One that somebody flies already, or takes over in flight, is
left alone. Neither Ctrl-C nor anything else ends the autopilots: the vehicles are landed and left. Nobody knows where they
truly are: estimated_N.csv instead of truth_N.csv holds what each told of itself in the air, ten times a second, and
summary.json says `tracks: estimated`. Of the scenario's stand_in section nothing is used.

On a busy machine it says so after the figures: where more than 0.5 % of the ticks were missed, or an agent took more than
5 ms (p99) from telemetry to command, they are the machine's rather than the law's.

Ctrl-C lands all vehicles and stops everything; a second Ctrl-C stops at once.

exit codes:
  0    flown and landed
  1    the flight failed; the one line says which vehicle and why, the logs say more
  2    the scenario, an argument or a port cannot be used; the one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
"""


@dataclass(frozen=True, slots=True)
class FlyOptions:
    run: RunOptions
    port_offset: int = 0
    external: Path | None = None  # the file of the vehicles that something else has started


def add_fly_arguments(parser: argparse.ArgumentParser) -> None:
    add_run_arguments(parser)
    parser.add_argument(
        "--external",
        type=Path,
        metavar="FILE",
        help="start no stand-ins: fly the vehicles of this file, which something else has started",
    )
    parser.add_argument(
        "--port-offset",
        type=port_offset,
        default=0,
        metavar="N",
        help="move all ports by N, so that two fleets can fly on one machine",
    )


def fly_options(parsed: argparse.Namespace) -> FlyOptions:
    """Raises ConfigError."""
    if parsed.external and parsed.autopilot:
        raise ConfigError(
            "--autopilot", "", "takes stand-ins of these manners, --external takes none; give one of them"
        )
    return FlyOptions(run_options(parsed), parsed.port_offset, parsed.external)


def port_offset(text: str) -> int:
    if not text.isdecimal() or int(text) > MAX_PORT_OFFSET:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number from 0 to {MAX_PORT_OFFSET}")
    return int(text)
