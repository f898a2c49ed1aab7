"""The changes of `companion fleet`: the options of its actions formation and reference."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from companion.cli.options import number

if TYPE_CHECKING:
    from companion.ground.changes import FormationRequest, ReferenceRequest

FORMATION = """\
Change the slots about the reference, in flight as well. Three ways: a named shape, whose slots
are assigned so that no two paths cross; a file with the slot of each vehicle; or, with neither,
the present slots, scaled and rotated. Nothing is sent where two slots would be closer than
separation_m of the fleet file, also on the way. With formation_heading: course in the fleet file,
x points along the motion of the reference instead of east, and so does heading 0.
"""
FORMATION_EXAMPLES = """\
examples:
  companion fleet formation diamond --spacing 4 --heading 90 --fleet fleet.yaml
  companion fleet formation --slots slots.yaml --fleet fleet.yaml
  companion fleet formation --scale 1.5 --fleet fleet.yaml     the present slots, farther out

slots.yaml, metres from the reference for every vehicle of the fleet:
  slots_enu_m:
    1: [0, 0, 0]
    2: [-3, 1.5, 0]
"""
REFERENCE = """\
Change the reference trajectory (RFT) of the formation, in flight as well. It is sent to the
vehicles that may lead. All begin it at the same time, and the present reference blends smoothly
into it. A reference that leaves the fence or exceeds the limits is refused; the refusal names a
value that works.
"""
REFERENCE_EXAMPLES = """\
examples:
  companion fleet reference point --at 10 -5 4 --fleet fleet.yaml
  companion fleet reference waypoints --at 0 0 4 --at 20 0 4 --at 20 15 6 --speed 3
  companion fleet reference circle --at 0 0 4 --radius 8 --period 30 --fleet fleet.yaml
  companion fleet reference figure_8 --at 0 0 4 --width 20 --height 8 --period 40 --fleet fleet.yaml
  companion fleet reference target --name walker --offset 0 0 6 --fleet fleet.yaml
  companion fleet reference --file reference.yaml --fleet fleet.yaml

--at is the position of a point, each waypoint, the centre of a circle or figure 8, and where the
fleet waits for a target; without it, a target is awaited at the present reference. The options
have the meaning of the keys of a file:
  reference: {kind: circle, centre_enu_m: [0, 0, 4], radius_m: 8, period_s: 30, clockwise: true}
"""

OPTION_PREFIX = "reference."  # argparse destinations that begin so are keys of the reference file


def add_formation_options(parser: argparse.ArgumentParser) -> None:
    from companion.geometry.formations import SHAPES

    shapes = ", ".join(sorted(SHAPES))
    parser.add_argument("shape", nargs="?", choices=sorted(SHAPES), metavar="SHAPE", help=shapes)
    parser.add_argument(
        "--spacing",
        type=number("metres above 0, up to 1000", 0.001, 1000.0),
        metavar="M",
        help="of a shape: the smallest distance of two slots, metres",
    )
    parser.add_argument("--slots", type=Path, metavar="FILE", help="a file with slots_enu_m (YAML) instead of a shape")
    parser.add_argument(
        "--heading",
        type=number("degrees from -360 to 360", -360.0, 360.0),
        default=0.0,
        metavar="DEG",
        help="rotation counterclockwise: the front of a shape points 0 east (default), 90 north",
    )
    parser.add_argument(
        "--scale",
        type=number("a factor from 0.01 to 100", 0.01, 100.0),
        default=1.0,
        metavar="X",
        help="factor on every slot",
    )


def formation_request(parsed: argparse.Namespace) -> FormationRequest:
    from companion.ground.changes import FormationRequest

    return FormationRequest(parsed.shape, parsed.slots, parsed.spacing, parsed.heading, parsed.scale)


def add_reference_options(parser: argparse.ArgumentParser) -> None:
    """One option for each key that a kind of reference asks for; the kinds are those of `config/reference`."""
    from companion.config.reference import ASKED, PLACED, type_of_key

    three = ("EAST", "NORTH", "UP")
    parser.add_argument("kind", nargs="?", choices=tuple(PLACED), metavar="KIND", help=", ".join(PLACED))
    parser.add_argument(
        "--file", type=Path, metavar="FILE", help="a file with a section reference (YAML) instead of KIND"
    )
    parser.add_argument(
        "--at", action="append", nargs=3, type=float, default=[], metavar=three, help="metres, fleet frame"
    )
    forms: dict[type, dict[str, Any]] = {
        float: {"type": float, "metavar": "X"},
        bool: {"action": "store_const", "const": True},
        str: {"metavar": "NAME"},
        tuple: {"nargs": 3, "type": float, "metavar": three},
    }
    for key, asked in ASKED.items():
        parser.add_argument(asked.option, dest=f"{OPTION_PREFIX}{key}", help=asked.meaning, **forms[type_of_key(key)])


def reference_request(parsed: argparse.Namespace) -> ReferenceRequest:
    from companion.ground.changes import ReferenceRequest

    options = {
        name.removeprefix(OPTION_PREFIX): value
        for name, value in vars(parsed).items()
        if name.startswith(OPTION_PREFIX) and value is not None
    }
    kind = {"kind": parsed.kind} if parsed.kind else {}
    return ReferenceRequest(parsed.file, kind | options, tuple(parsed.at))
