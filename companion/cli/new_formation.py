"""Options of the commands that write the files of a new formation: `companion init` and `sitl new`."""

from __future__ import annotations

import argparse
from typing import get_args

from companion.config.fleet import LawName
from companion.config.new_formation import NewFormation, ReferenceKind
from companion.config.planned_flight import TOPOLOGY_WORDS, ShapeName, Topology

TOPOLOGIES = "topologies:\n" + "\n".join(f"  {name:<8} {words}" for name, words in TOPOLOGY_WORDS.items())


def add_formation(parser: argparse.ArgumentParser) -> None:
    """The choices of a formation. Their defaults are those of NewFormation."""
    parser.add_argument("--vehicles", type=int, required=True, metavar="N", help="number of vehicles; vehicle 1 leads")
    parser.add_argument("--shape", choices=get_args(ShapeName), default="line", help="shape (default line)")
    parser.add_argument(
        "--spacing", type=float, default=3.0, metavar="M", help="smallest distance between slots (default 3)"
    )
    parser.add_argument("--topology", choices=get_args(Topology), default="chain", help="neighbours (default chain)")
    parser.add_argument(
        "--reference", choices=get_args(ReferenceKind), default="point", help="reference (default point)"
    )
    parser.add_argument("--law", choices=get_args(LawName), default="cooperative", help="law (default cooperative)")
    parser.add_argument(
        "--heading",
        choices=("fixed", "course"),
        default="fixed",
        help="fixed: the formation points east; course: it turns with the reference (default fixed)",
    )
    parser.add_argument("--height", type=float, default=3.0, metavar="M", help="height of the flight (default 3)")
    parser.add_argument(
        "--may-lead", type=int, nargs="+", default=[], metavar="ID", help="followers that can become leader"
    )


def formation_of(parsed: argparse.Namespace, name: str) -> NewFormation:
    """The choices of the command line."""
    return NewFormation(
        name=name,
        vehicles=parsed.vehicles,
        shape=parsed.shape,
        spacing_m=parsed.spacing,
        topology=parsed.topology,
        reference=parsed.reference,
        law=parsed.law,
        heading=parsed.heading,
        height_m=parsed.height,
        may_lead=tuple(dict.fromkeys(parsed.may_lead)),
    )
