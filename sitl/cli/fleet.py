"""`sitl fleet`: the processes of a whole fleet, on the ground, commanded by `companion fleet`."""

from __future__ import annotations

import argparse

from companion.cli.options import add_overrides
from sitl.cli.options import add_autopilot, add_out, add_port_offset, add_scenario, overrides_of
from sitl.flight.options import FleetOptions

HELP = "a fleet of real processes that waits on the ground for `companion fleet`"
DESCRIPTION = """\
A scenario's fleet as real processes, one stand-in autopilot and one agent per vehicle. It waits on the ground for an
operator: `companion fleet` in a second terminal. The scenario's timeline is not flown; its targets move.
"""

MORE = """\
examples:
  sitl fleet config/scenarios/ring_figure_8.yaml
  sitl fleet config/scenarios/formations.yaml --set stand_in.sensors=ideal
  sitl fleet config/scenarios/platoon.yaml --autopilot ardupilot --port-offset 100

It prints what `companion fleet` needs and the ports for ground stations. Without --port-offset it takes the first of the
offsets 0, 100, 200, ... with which all ports are free, so that several fleets can fly side by side.

the folder (default: a new one, runs/fleet-SCENARIO-DATE-TIME; files of an older run in --out are removed):
  fleet.yaml                     for `companion fleet --fleet`; vehicle_N.yaml, autopilot_N.yaml, scenario.yaml
  truth_N.csv                    true positions of vehicle N, 50 times a second
  agent_N.log                    output of the agents: every command and its answer is a line
  autopilots_1_to_M.log          output of the stand-ins, up to sixteen in one process
  vehicle_N_*.mcap               what the agent of vehicle N received and decided (docs/recording.md)

Ctrl-C takes command, lands all vehicles where they are and stops everything; a second Ctrl-C stops at once. On a busy
machine the last lines report it: where more than 0.5 % of the ticks were missed, or an agent took more than 5 ms (p99) from
telemetry to command.

exit codes:
  0    ended by Ctrl-C, all vehicles landed
  1    a vehicle could not be landed, or a process could not be ended; one line says which and why, the logs say more
  2    the scenario, an argument, a port or the folder cannot be used; one line says which and what to do
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_scenario(parser)
    add_autopilot(parser)
    add_overrides(parser, "change one key of the scenario")
    add_out(parser)
    parser.add_argument("--quiet", action="store_true", help="do not show the vehicles, only how to command them")
    add_port_offset(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.flight.fly import run_fleet

    return run_fleet(fleet_options(parsed))


def fleet_options(parsed: argparse.Namespace) -> FleetOptions:
    return FleetOptions(parsed.scenario, overrides_of(parsed), parsed.out, parsed.quiet, parsed.port_offset)
