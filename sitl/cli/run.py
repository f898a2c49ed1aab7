"""`sitl run`: a scenario in virtual time. `sitl fly` shares most of its options."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import get_args

from companion.cli.options import add_overrides
from companion.config.fleet import LawName
from sitl.cli.options import add_autopilot, add_out_and_quiet, add_scenario, overrides_of
from sitl.flight.options import RunOptions

LAWS: tuple[LawName, ...] = get_args(LawName)

HELP = "flies a scenario in virtual time: one process, many times faster, bit-identical each time"
DESCRIPTION = """\
Fly a scenario in virtual time: the same agents and stand-in autopilots as `sitl fly`, in one loop without sockets, many times
faster than real time. The same scenario and seed give a bit-identical flight.
"""

MORE = """\
examples:
  sitl run config/scenarios/platoon.yaml                        the paper's platoon with the paper's law
  sitl run config/scenarios/platoon.yaml --compare              all laws in turn, one table, one figure
  sitl run config/scenarios/platoon.yaml --set stand_in.sensors=default --set stand_in.seed=2
  sitl run config/scenarios/platoon.yaml --autopilot ardupilot  stand-ins that behave like ArduCopter instead of PX4
  sitl run config/scenarios/platoon.yaml --set links.peer_loss=0.1 --set links.peer_delay_s=0.1

--set takes any key of the scenario file, [N] for the N-th item of a list from 0, and a YAML value. The section links sets
the delays of telemetry, setpoints and peer packets, the shares of peer packets that are lost and repeated, and partitions.

Before the flight the formation is checked as by `companion analyze`: one without a path from a leader to every vehicle, or
one that is unstable with the usual delay, is refused; --anyway flies it.

the folder (default: a new one, runs/SCENARIO-LAW-DATE-TIME; with --compare one folder per law inside it; files of an older
run in --out are removed; a folder that another run uses is refused):
  summary.json              as of `sitl fly`, with real_time_factor: seconds flown per second of computing time. Timing
                            (tick, telemetry_to_command_us, cpu_percent, rss_mb) is null in virtual time
  figure_5.png, figure_6.png, from_above.png, comparison.json, comparison.png, scenario.yaml      as of `sitl fly`
  truth_N.csv               true positions of vehicle N, 50 times a second; its clock is virtual and begins at 0
  vehicle_N_*.mcap          with --record: what the agent of vehicle N received and decided, by the virtual clock

Ctrl-C lands all vehicles, which takes no time here, and writes the folder; a second Ctrl-C stops at once.

exit codes:
  0    flown and landed
  1    the flight failed; one line says which vehicle and why
  2    the scenario, an argument or the folder cannot be used; one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), vehicles landed
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    add_flight_arguments(parser)
    parser.add_argument(
        "--record",
        action="store_true",
        help="leave the recordings of the agents, as `sitl fly` does",
    )


def add_flight_arguments(parser: argparse.ArgumentParser) -> None:
    """What `sitl run` and `sitl fly` have in common."""
    add_scenario(parser)
    parser.add_argument("--law", choices=LAWS, help="fly with this law (short for --set fleet.law.name=LAW)")
    add_autopilot(parser)
    parser.add_argument(
        "--compare",
        nargs="*",
        choices=LAWS,
        metavar="LAW",
        help="fly with the scenario's law, then with these (default: with all others), and compare",
    )
    add_overrides(parser, "change one key of the scenario")
    parser.add_argument("--anyway", action="store_true", help="fly a formation that `companion analyze` rejects")
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.flight.flights import run_virtual

    return run_virtual(run_options(parsed))


def run_options(parsed: argparse.Namespace) -> RunOptions:
    others: Sequence[LawName] | None = parsed.compare
    if others is not None and not others:
        others = LAWS
    record = getattr(parsed, "record", True)  # real agents always record
    return RunOptions(parsed.scenario, overrides_of(parsed), others, parsed.out, parsed.quiet, parsed.anyway, record)
