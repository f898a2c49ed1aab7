"""The command line of where a fleet flies: `companion fleet formation` and `companion fleet reference`."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from companion.arguments import number
from companion.geometry.shapes import SHAPES
from companion.types import Described

FORMATION = """\
Other slots about the reference, gone to in flight: a named shape, whose slots are assigned so that no two ways cross; a file
that says whose slot is where; or, with neither, the slots that are flown now, scaled and turned. Nothing is asked where two
slots would come nearer than the fleet file's separation_m, also on the way. Where that file has formation_heading: course, x is
not east but where the reference goes, and so is heading 0.
"""

FORMATION_MORE = """\
examples:
  companion fleet formation diamond --spacing 4 --heading 90 --fleet fleet.yaml
  companion fleet formation --slots slots.yaml --fleet fleet.yaml
  companion fleet formation --scale 1.5 --fleet fleet.yaml             what is flown now, half as large again

slots.yaml, metres from the reference for every vehicle of the fleet:
  slots_enu_m:
    1: [0, 0, 0]
    2: [-3, 1.5, 0]
"""

REFERENCE = """\
Another reference (RFT) for those that may lead, in flight as well: where the formation goes. All vehicles begin it at once,
and the old one passes smoothly into it. What leaves the fence or asks for too much is refused, with what would do.
"""

REFERENCE_MORE = """\
examples:
  companion fleet reference point --at 10 -5 4 --fleet fleet.yaml
  companion fleet reference waypoints --at 0 0 4 --at 20 0 4 --at 20 15 6 --speed 3 --fleet fleet.yaml
  companion fleet reference circle --at 0 0 4 --radius 8 --period 30 --fleet fleet.yaml
  companion fleet reference figure_8 --at 0 0 4 --width 20 --height 8 --period 40 --fleet fleet.yaml
  companion fleet reference target --name walker --offset 0 0 6 --fleet fleet.yaml
  companion fleet reference --file reference.yaml --fleet fleet.yaml

--at is the place of a point, each of the waypoints, the middle of a circle or an 8, and where a target is waited for: without
it, where the reference is now. What the options say stands in files with the same meaning; a file can say all, as in
  reference: {kind: circle, centre_enu_m: [0, 0, 4], radius_m: 8, period_s: 30, clockwise: true}
"""

REFERENCE_KEY = "reference."  # before the key of a file, where argparse keeps what an option says
KINDS = ("point", "waypoints", "circle", "figure_8", "target")
NUMBERS = {  # option -> key of a file, and what it is
    "--radius": ("radius_m", "of a circle, metres"),
    "--width": ("width_m", "of a whole 8, along x, metres"),
    "--height": ("height_m", "of a whole 8, along y, metres"),
    "--period": ("period_s", "of a lap of a circle or an 8, seconds"),
    "--ramp": ("ramp_s", "until a circle or an 8 has its pace, seconds"),
    "--pause": ("wait_s", "at each waypoint, seconds"),
    "--speed": ("max_speed_m_s", "limit of waypoints or a target, m/s"),
    "--acceleration": ("max_acceleration_m_s2", "likewise, m/s^2"),
}


@dataclass(frozen=True, slots=True)
class FormationWish:
    """A shape by its name, or `slots_file`, or neither: what is flown now. `spacing_m` goes with a shape."""

    shape: str | None
    slots_file: Path | None
    spacing_m: float | None
    heading_deg: float
    scale: float


@dataclass(frozen=True, slots=True)
class ReferenceWish:
    """A file, or what the command line says in a file's words, without the place; `places_enu_m` is every --at."""

    file: Path | None
    described: Described
    places_enu_m: tuple[list[float], ...]


def add_formation_arguments(parser: argparse.ArgumentParser) -> None:
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
        help="turned counterclockwise by so much: a shape's front is then 0 east (default), 90 north",
    )
    parser.add_argument("--scale", type=_scale, default=1.0, metavar="X", help="every slot so many times as far out")


def formation_wish(parsed: argparse.Namespace) -> FormationWish:
    return FormationWish(parsed.shape, parsed.slots, parsed.spacing, parsed.heading, parsed.scale)


def add_reference_arguments(parser: argparse.ArgumentParser) -> None:
    def add(option: str, key: str, **more: Any) -> None:
        parser.add_argument(option, dest=f"{REFERENCE_KEY}{key}", **more)

    three = ("EAST", "NORTH", "UP")
    parser.add_argument("kind", nargs="?", choices=KINDS, metavar="KIND", help=", ".join(KINDS))
    parser.add_argument(
        "--file", type=Path, metavar="FILE", help="a file with a section reference (YAML) instead of KIND"
    )
    parser.add_argument(
        "--at", action="append", nargs=3, type=float, default=[], metavar=three, help="metres, fleet frame"
    )
    for option, (key, meaning) in NUMBERS.items():
        add(option, key, type=float, metavar="X", help=meaning)
    add("--clockwise", "clockwise", action="store_const", const=True, help="a circle, seen from above")
    add("--name", "name", metavar="NAME", help="of the target (default main)")
    offset = "from the target to the reference, metres"
    add("--offset", "offset_enu_m", nargs=3, type=float, metavar=three, help=offset)
    add("--follows-altitude", "follows_altitude", action="store_const", const=True, help="the target's altitude, too")


def reference_wish(parsed: argparse.Namespace) -> ReferenceWish:
    said = {
        name.removeprefix(REFERENCE_KEY): value
        for name, value in vars(parsed).items()
        if name.startswith(REFERENCE_KEY) and value is not None
    }
    kind = {"kind": parsed.kind} if parsed.kind else {}
    return ReferenceWish(parsed.file, kind | said, tuple(parsed.at))


def _spacing(text: str) -> float:
    return number(text, "metres above 0, up to 1000", 0.001, 1000.0)


def _heading(text: str) -> float:
    return number(text, "degrees from -360 to 360", -360.0, 360.0)


def _scale(text: str) -> float:
    return number(text, "a factor from 0.01 to 100", 0.01, 100.0)
