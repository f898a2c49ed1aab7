"""`companion analyze`: the command line of the formation analysis."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from companion.cli.options import add_overrides, fail

NAME = "analyze"
SUMMARY = "predicts the behaviour of a formation before it flies"
EXIT_CONVERGES, EXIT_CANNOT_CONVERGE, EXIT_FILE = 0, 1, 2
DESCRIPTION = """\
Predict the behaviour of a formation before it flies: the neighbours of each vehicle, the
interaction matrix G under each law, its eigenvalues, rate, damping and delay margin, the largest
and smallest distances to expect, and a verdict.
"""

MORE = """\
examples:
  companion analyze config/scenarios/platoon.yaml
  companion analyze config/scenarios/chain_16.yaml --set fleet.law.weight_ratio=0.1
  companion analyze /etc/companion/fleet.yaml --json | jq '.laws.weighted.lambda_min'

A scenario defines the start positions and the reference; a fleet file alone is analyzed for a
step of 1 m. The predictions come from a linear model with an attitude lag of 0.2 s and a delay of
50 ms, without noise and limits. This lag is on the safe side: the stand-ins and the autopilots'
own simulations follow faster, and large fleets settle sooner there. --set takes any key of the
file and a YAML value.

exit codes:
  0    the formation converges, whatever else the verdict reports
  1    it cannot converge: no path to a leader, or an unstable law with that lag and delay
  2    the file cannot be used
  130  ended by Ctrl-C
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="a scenario or fleet file (YAML)")
    add_overrides(parser, "change one key of the file")
    parser.add_argument("--json", action="store_true", help="all figures as one JSON object instead of the text")


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # numpy's matrices are small: threads only wait for each other

    import msgspec

    from companion.config.file import ConfigError
    from companion.tools.analysis import analyse, load_subject
    from companion.tools.analysis_report import report, verdict

    try:
        analysis = analyse(load_subject(options.file, options.overrides))
    except ConfigError as error:
        return fail(str(error), EXIT_FILE)
    if options.json:
        figures = msgspec.to_builtins(analysis) | {"verdict": msgspec.to_builtins(verdict(analysis))}
        print(msgspec.json.format(msgspec.json.encode(figures), indent=2).decode())
    else:
        print(report(analysis))
    return EXIT_CONVERGES if analysis.converges else EXIT_CANNOT_CONVERGE
