"""The command line of `sitl study`. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from pathlib import Path

DESCRIPTION = """\
What lies past the paper: chains, rings, grids and random geometric graphs of 4 to 100 vehicles, the full quadrotor model, every
setting of the law (exponent, gains, neighbours' acceleration fed forward, leader coupled or not, one by one and together), with
noise, late and lost packets; spectra of up to 10,000 vehicles; and what the law `cooperative` is to reach, with a verdict.
"""
MORE = """\
examples:
  sitl study                            some minutes on two cores
  sitl study --full --out /tmp/study    more shapes, more seeds and longer flights

the folder (default: runs/study-DATE-TIME): study.json (every flight, the verdicts and the spectra), trade_off.png (settling
against the worst inter-distance for every setting), spectra.png

exit codes: 0 flown, whatever the verdicts; 1 a process ended before its flights did, most likely for want of memory; 2 an
argument cannot be used; 130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), which leaves no results
"""


def add_study_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--full", action="store_true", help="more shapes, more seeds, longer flights (an hour and more)"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")
    parser.add_argument("--quiet", action="store_true", help="print the result only")
