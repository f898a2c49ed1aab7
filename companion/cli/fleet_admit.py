"""`companion fleet admit`: sends a new admission list to the agents of a running fleet."""

from __future__ import annotations

import argparse
from pathlib import Path

NAME = "admit"
SUMMARY = "sends a new admission list to the vehicles, as after companion provision revoke"
DESCRIPTION = """\
Send an admission list to all vehicles. Each one verifies that the authority of the fleet has signed
it and that it is newer than its own, keeps it, and from then on uses nothing of a participant that
is no longer admitted. A new identity is connected when the agents start again.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=Path, metavar="FILE", help="admitted.json of the own identity, or of any other")
