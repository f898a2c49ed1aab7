"""The options of `companion fleet formation`."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from companion.cli.options import number
from companion.geometry.formations import SHAPES

if TYPE_CHECKING:
    from companion.ground.changes import FormationRequest

DESCRIPTION = """\
Change the slots about the reference, in flight as well. Three ways: a named shape, whose slots
are assigned so that no two paths cross; a file with the slot of each vehicle; or, with neither,
the present slots, scaled and rotated. Nothing is sent where two slots would be closer than
separation_m of the fleet file, also on the way. With formation_heading: course in the fleet file,
x points along the motion of the reference instead of east, and so does heading 0.
"""

MORE = """\
examples:
  companion fleet formation diamond --spacing 4 --heading 90 --fleet fleet.yaml
  companion fleet formation --slots slots.yaml --fleet fleet.yaml
  companion fleet formation --scale 1.5 --fleet fleet.yaml     the present slots, farther out

slots.yaml, metres from the reference for every vehicle of the fleet:
  slots_enu_m:
    1: [0, 0, 0]
    2: [-3, 1.5, 0]
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    shapes = ", ".join(sorted(SHAPES))
    parser.add_argument("shape", nargs="?", choices=sorted(SHAPES), metavar="SHAPE", help=shapes)
    parser.add_argument(
        "--spacing", type=_spacing, metavar="M", help="of a shape: the smallest distance of two slots, metres"
    )
    parser.add_argument("--slots", type=Path, metavar="FILE", help="a file with slots_enu_m (YAML) instead of a shape")
    parser.add_argument(
        "--heading",
        type=_heading,
        default=0.0,
        metavar="DEG",
        help="rotation counterclockwise: the front of a shape points 0 east (default), 90 north",
    )
    parser.add_argument("--scale", type=_scale, default=1.0, metavar="X", help="factor on every slot")


def formation_request(parsed: argparse.Namespace) -> FormationRequest:
    from companion.ground.changes import FormationRequest

    return FormationRequest(parsed.shape, parsed.slots, parsed.spacing, parsed.heading, parsed.scale)


def _spacing(text: str) -> float:
    return number(text, "metres above 0, up to 1000", 0.001, 1000.0)


def _heading(text: str) -> float:
    return number(text, "degrees from -360 to 360", -360.0, 360.0)


def _scale(text: str) -> float:
    return number(text, "a factor from 0.01 to 100", 0.01, 100.0)
