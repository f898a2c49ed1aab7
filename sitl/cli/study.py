"""`sitl study`: every setting of the law on formations of 4 to 100 vehicles."""

from __future__ import annotations

import argparse

from sitl.cli.options import add_cluster, add_out_and_quiet

HELP = "beyond the paper: every setting of the law on formations of 4 to 100 vehicles"
DESCRIPTION = """\
Beyond the paper: chains, rings, grids and random geometric graphs of 4 to 100 vehicles, the full quadrotor model, every
setting of the law (weights, gains, neighbours' acceleration fed forward, leader coupled or not, one by one and together), with
noise, delayed and lost packets; the candidates that the setting of `cooperative` is chosen from; spectra of up to 10,000
vehicles; and the goals of `cooperative`, each with a verdict.
"""
MORE = """\
examples:
  sitl study                            a quarter of an hour on two cores
  sitl study --full --out /tmp/study    more shapes, more seeds and longer flights

the folder (default: a new one, runs/study-DATE-TIME): study.json (every flight, the verdicts and the spectra), trade_off.png
(settling against the worst inter-distance for every setting), selection.png (the candidates and the chosen one), spectra.png

exit codes: 0 flown, whatever the verdicts; 1 a process ended before its flights did, most likely for lack of memory; 2 an
argument cannot be used; 130 ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM), without results
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--full", action="store_true", help="more shapes, more seeds, longer flights (an hour and more)"
    )
    add_cluster(parser)
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.study.command import run_study_command

    return run_study_command(parsed)
