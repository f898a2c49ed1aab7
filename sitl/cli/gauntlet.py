"""`sitl gauntlet`: random flights of whole fleets, and how close their vehicles come to each other."""

from __future__ import annotations

import argparse
from pathlib import Path

from sitl.cli.options import add_cluster, add_out_and_quiet, whole_number

MOST_FLIGHTS, MOST_SEED, MOST_JOBS = 100_000, 999_999_999, 256

HELP = "random flights of whole fleets in virtual time: how close do vehicles come, and do they reach their slots?"
DESCRIPTION = """\
Fly random flights with the agents that fly for real, in virtual time and on all cores: formation changes, crossing paths,
joining and leaving vehicles, lost leaders, split networks, fast references and more, under the laws weighted and
cooperative, with both autopilots, ideal and noisy sensors, delay and loss. Every tenth flight has a runaway vehicle that
flies straight on. The true distances of all pairs are measured at 50 Hz. The same seed gives the same flights bit for bit.
"""
MORE = """\
examples:
  sitl gauntlet                                        100 flights with seed 1 (some minutes)
  sitl gauntlet --families joining,exchange --seed 7   two families only
  sitl gauntlet --sensors ideal --flights 1000 --jobs 4
  sitl gauntlet --fleet fleet.yaml                     your own fleet, with its slots, law and separation_m

the folder (default: a new one, runs/gauntlet-DATE-TIME): gauntlet.json (every flight and the summaries), and the ten worst
flights as scenario files: `sitl run FOLDER/FLIGHT.yaml` flies one again and plots it. FLIGHT.txt is the traceback of a flight
that ended in an exception

exit codes: 0 flown without a violation; 1 two vehicles came closer than allowed, an agent raised an exception, or a process
ended before its flights did; 2 an argument or the fleet file cannot be used; 130 stopped by Ctrl-C (129 by SIGHUP, 143 by
SIGTERM), with the results of the flights that were complete
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--flights",
        type=whole_number(1, MOST_FLIGHTS),
        default=100,
        metavar="N",
        help="number of flights (default 100)",
    )
    parser.add_argument("--seed", type=whole_number(0, MOST_SEED), default=1, metavar="S", help="(default 1)")
    parser.add_argument("--families", metavar="A,B", help="families of flights; a wrong name lists them (default: all)")
    parser.add_argument(
        "--sensors", choices=("ideal", "default", "px4_sih"), help="of all flights (default: random for each flight)"
    )
    parser.add_argument("--fleet", type=Path, metavar="FILE", help="fly this fleet instead of random ones")
    place = parser.add_mutually_exclusive_group()
    place.add_argument("--jobs", type=whole_number(1, MOST_JOBS), metavar="N", help="processes (default: one per core)")
    add_cluster(place)
    parser.add_argument("--page", type=Path, metavar="FILE", help="also write the table as a Markdown page")
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.gauntlet.command import run_gauntlet

    return run_gauntlet(parsed)
