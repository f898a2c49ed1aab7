"""`sitl new`: the command line that writes a first scenario."""

from __future__ import annotations

import argparse
from pathlib import Path

from companion.cli.new_formation import TOPOLOGIES, add_formation, formation_of

HELP = "writes a commented scenario file from a few choices"
DESCRIPTION = """\
Write a commented scenario file NAME.yaml that flies as it is: vehicles with their slots, neighbours,
law, reference, fence and timeline. The pace of the reference and the fence fit the formation. An
existing file is not overwritten.
"""

MORE = f"""\
examples:
  sitl new v_on_circle --vehicles 5 --shape v --spacing 3 --reference circle
  sitl new eight --vehicles 6 --shape column --topology double --reference figure_8 --heading course
  sitl new gather --vehicles 4 --shape circle --topology range --folder scenarios

{TOPOLOGIES}

exit codes:
  0  written; the last lines are the commands to go on with
  2  an argument cannot be used, or the file exists
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", metavar="NAME", help="name of the file and of the fleet")
    add_formation(parser)
    parser.add_argument("--folder", type=Path, default=Path(), metavar="DIR", help="where to write it (default: here)")


def run(parsed: argparse.Namespace) -> int:
    from sitl.flight.new_scenario import new_scenario

    print(new_scenario(formation_of(parsed, parsed.name), parsed.folder), end="")
    return 0
