"""`sitl switching`: neighbour sets that change with range, from random starts, under every law."""

from __future__ import annotations

import argparse

from sitl.cli.options import add_cluster, add_out_and_quiet, number, whole_number

MOST_STARTS, MOST_VEHICLES, MOST = 100_000, 50, 600.0

HELP = "neighbour sets that change with range: connectivity from a thousand random starts under each law"
DESCRIPTION = """\
Neighbour sets that change with range: random starts from which the graph is connected and a goal leads the formation away,
flown under every law with the full quadrotor model, without and with hysteresis. Slots are assigned so that the sum of the
squared distances to them is smallest, and few paths cross. How often are edges lost, how small does lambda_min become, and from
which starts does every vehicle keep a path to the leader? In how many flights do vehicles come too close to each other, or
continue where real agents would hand over to the autopilot?
"""
MORE = """\
examples:
  sitl switching                                  1,000 starts of six vehicles with a range of 3 m (some minutes)
  sitl switching --starts 100 --vehicles 10 --range 4 --out /tmp/switching

the folder (default: a new one, runs/switching-DATE-TIME): switching.json (every flight and the summaries), switching.png

exit codes: 0 flown; 1 a process ended before its flights did, most likely for lack of memory; 2 an argument cannot be used;
130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), without results
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    starts, vehicles = whole_number(1, MOST_STARTS), whole_number(2, MOST_VEHICLES)
    positive = number(f"a number above 0, up to {MOST:g}", lambda value: 0.0 < value <= MOST)
    parser.add_argument("--starts", type=starts, default=1000, metavar="N", help="random starts (default 1000)")
    parser.add_argument("--vehicles", type=vehicles, default=6, metavar="N", help="in each formation (default 6)")
    parser.add_argument("--range", type=positive, default=3.0, metavar="M", help="range of neighbours (default 3 m)")
    parser.add_argument(
        "--hysteresis", type=positive, default=0.3, metavar="M", help="the second of two, after 0 (default 0.3 m)"
    )
    parser.add_argument("--seconds", type=positive, default=30.0, metavar="S", help="of each flight (default 30)")
    add_cluster(parser)
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.switching.command import run_switching

    return run_switching(parsed)
