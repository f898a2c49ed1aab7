"""`sitl paper`: every claim of the paper, computed or flown."""

from __future__ import annotations

import argparse

from sitl.cli.options import add_cluster, add_out_and_quiet

HELP = "every claim of the paper computed or flown again, on one page"
DESCRIPTION = """\
Reproduce Hou and Zhang (Robotica 2021): compute every claim of the theory, fly figures 4 to 10 with the agents that fly real
vehicles, and write a page that states which claims hold.
"""

MORE = """\
examples:
  sitl paper --out runs/paper
  sitl paper --out runs/paper --full         more graphs and more flights with sensor noise

the folder (default: a new one, runs/paper-DATE-TIME):
  index.html       claims with verdicts, errata, figures beside what the paper states
  claims.json      the same claims with the numbers behind them, versions, and the time taken
  *.png            the figures

exit codes:
  0    written; a claim that does not hold is a result, not a failure
  1    a flight that a figure needs had no formation, or a process ended before its flights did; one line says which
  2    an argument cannot be used; one line says which and what to do
  130  ended by Ctrl-C (129 by SIGHUP, 143 by SIGTERM)
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--full", action="store_true", help="more graphs and more flights with sensor noise")
    add_cluster(parser)
    add_out_and_quiet(parser)


def run(parsed: argparse.Namespace) -> int:
    from sitl.paper.command import PaperOptions, run_paper
    from sitl.report.folder import results_folder

    return run_paper(PaperOptions(results_folder(parsed.out, "paper"), parsed.full, parsed.quiet, parsed.cluster))
