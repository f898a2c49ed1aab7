"""`sitl fly`: a whole fleet of real processes through a scenario."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.config.file import ConfigError
from sitl.cli.options import add_port_offset
from sitl.cli.run import add_flight_arguments, run_options
from sitl.flight.options import FlyOptions

HELP = "a whole fleet of real processes through a scenario, with figures at its end"
DESCRIPTION = """\
Fly a scenario with real processes: one stand-in autopilot and one agent per vehicle, MAVLink between them, Zenoh between
the agents. Shows every vehicle live, lands, and leaves a folder with figures, plots, files and logs. With --external the
agents fly external autopilots, like PX4's and ArduPilot's own simulations.
"""

MORE = """\
examples:
  sitl fly config/scenarios/platoon.yaml                        the paper's platoon with the paper's law
  sitl fly config/scenarios/platoon.yaml --law average_22       with another law
  sitl fly config/scenarios/platoon.yaml --compare              all laws in turn, one table, one figure
  sitl fly config/scenarios/platoon.yaml --compare average_26   only these two
  sitl fly config/scenarios/platoon.yaml --autopilot ardupilot  stand-ins that behave like ArduCopter instead of PX4
  sitl fly config/scenarios/four_in_line.yaml --external config/external/px4_sih.yaml   four PX4 in their own simulation
  sitl fly config/scenarios/platoon.yaml --set stand_in.sensors=default --set timeline[3].for_s=20
  sitl fly config/scenarios/platoon.yaml --set stand_in.airframe.attitude=instant \\
                                         --set stand_in.airframe.motor_lag_s=0
  sitl fly runs/platoon-weighted-20250131-120000/scenario.yaml  repeat a flight exactly

--set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value.

Before the flight the formation is checked as by `companion analyze`: one without a path from a leader to every vehicle, or
one that is unstable with the usual delay, is refused; --anyway flies it. Without --port-offset it takes the first of the
offsets 0, 100, 200, ... with which all ports are free, so that several fleets can fly side by side.

the folder (default: a new one, runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; files of an older
run in --out are removed; a folder that another run uses is refused):
  summary.json                   largest, smallest and final distances, settling time, final error, timing of each agent
  figure_5.png, figure_6.png     x and y curves, inter-distances; all from true positions
  from_above.png                 the paths from above, with leaders and neighbours after each command
  comparison.json, .png          with --compare
  scenario.yaml                  as flown; fleet.yaml, vehicle_N.yaml, autopilot_N.yaml are made from it
  truth_N.csv                    true positions of vehicle N, 50 times a second
  agent_N.log                    output of the agents; autopilots_1_to_M.log that of the stand-ins, which share a process
  vehicle_N_*.mcap               what the agent of vehicle N received and decided (docs/recording.md)

--external FILE flies the same scenario with agents alone. FILE gives for each vehicle the endpoint of its autopilot, its
hover thrust and its drag (see config/external/ and docs/external.md). No command is given before all vehicles are ready: the
autopilots' own checks pass, origin and position are known, parameters are in order, and each vehicle is on the ground within
10 m of its starts_enu_m, by fleet.origin, and apart from the others. A vehicle that is armed already, or that its pilot takes
over in flight, is left alone. Neither Ctrl-C nor a failure ends the autopilots: the vehicles are landed and left. Their true
positions are unknown: estimated_N.csv instead of truth_N.csv holds the positions that each reported in the air, ten times a
second, and summary.json has `tracks: estimated`. The stand_in section of the scenario is not used.

On a busy machine a line after the figures reports it: where more than 0.5 % of the ticks were missed, or an agent took more
than 5 ms (p99) from telemetry to command, the figures are those of the machine rather than of the law.

Ctrl-C lands all vehicles and stops everything; a second Ctrl-C stops at once.

exit codes:
  0    flown and landed
  1    the flight failed; one line says which vehicle and why, the logs say more
  2    the scenario, an argument, a port or the folder cannot be used; one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_flight_arguments(parser)
    parser.add_argument(
        "--external",
        type=Path,
        metavar="FILE",
        help="start no stand-ins: fly the external autopilots of this file",
    )
    add_port_offset(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.flight.fly import run_fly

    return run_fly(fly_options(parsed))


def fly_options(parsed: argparse.Namespace) -> FlyOptions:
    """Raises ConfigError."""
    if parsed.external and parsed.autopilot:
        raise ConfigError(
            "--autopilot", "", "chooses the stand-ins, and --external starts none; give one of the two options"
        )
    return FlyOptions(run_options(parsed), parsed.port_offset, parsed.external)
