"""The command line of `sitl switching`. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from math import nan
from pathlib import Path

MOST_STARTS, MOST_VEHICLES, MOST = 100_000, 50, 600.0

DESCRIPTION = """\
Neighbour sets that change with range: random starts from which the graph is connected and a goal leads the formation away,
flown under every law with the full quadrotor model, without hysteresis and with it. Slots are given out so that the squares of
the ways to them sum up to the least, and few cross. How often are edges lost, how small does lambda_min become, and from which
starts does everybody keep a path to the leader? How many come too close to each other, or fly on where real agents hand over?
"""
MORE = """\
examples:
  sitl switching                                  1,000 starts of six vehicles that see 3 m far (some minutes)
  sitl switching --starts 100 --vehicles 10 --range 4 --out /tmp/switching

the folder (default: runs/switching-DATE-TIME): switching.json (every flight and the summaries), switching.png

exit codes: 0 flown; 1 a process ended before its flights did, most likely for want of memory; 2 an argument cannot be used;
130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), which leaves no results
"""


def add_switching_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--starts", type=_count, default=1000, metavar="N", help="random starts (default 1000)")
    parser.add_argument("--vehicles", type=_vehicles, default=6, metavar="N", help="in each formation (default 6)")
    parser.add_argument("--range", type=_positive, default=3.0, metavar="M", help="how far they see (default 3 m)")
    parser.add_argument(
        "--hysteresis", type=_positive, default=0.3, metavar="M", help="the second of two, after 0 (default 0.3 m)"
    )
    parser.add_argument("--seconds", type=_positive, default=30.0, metavar="S", help="of each flight (default 30)")
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")
    parser.add_argument("--quiet", action="store_true", help="print the result only")


def _count(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= MOST_STARTS:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number from 1 to {MOST_STARTS}")
    return int(text)


def _vehicles(text: str) -> int:
    if not text.isdecimal() or not 2 <= int(text) <= MOST_VEHICLES:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a whole number from 2 to {MOST_VEHICLES}")
    return int(text)


def _positive(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = nan
    if not 0.0 < value <= MOST:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a number above 0, up to {MOST:g}")
    return value
