"""Command line options that several `sitl` commands share, and the values they accept."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from companion.cli.options import whole_number
from companion.config.named_files import law_override
from companion.types.autopilot import AutopilotKind
from sitl.links.ports import MAX_PORT_OFFSET

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

CLUSTER_ADDRESS = re.compile(r"(?P<protocol>(tcp|tls)://)?(?P<host>[\w.-]+|\[[\da-fA-F:.]+\]):(?P<port>[0-9]{1,5})")
LAST_PORT = 65535
Options = TypeVar("Options", bound="DataclassInstance")
ABOVE_0, BELOW_INFINITY = 5e-324, sys.float_info.max  # bounds of a number


def add_scenario(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "scenario",
        type=Path,
        metavar="SCENARIO",
        help="a scenario file, or the name of a shipped one (`sitl scenarios` lists them)",
    )


def add_autopilot(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--autopilot",
        choices=[str(kind) for kind in AutopilotKind],
        help="fly stand-ins that behave like this autopilot (short for --set stand_in.autopilot=AUTOPILOT)",
    )


def add_out(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")


def add_out_and_quiet(parser: argparse.ArgumentParser) -> None:
    add_out(parser)
    parser.add_argument("--quiet", action="store_true", help="print the result only; warnings go to standard error")


def add_cluster(parser: argparse._ActionsContainer) -> None:
    parser.add_argument(
        "--cluster",
        type=cluster_address,
        metavar="ADDRESS",
        help="fly on the workers of this Dask scheduler, [tcp://|tls://]HOST:PORT, instead of the cores of this machine "
        "(docs/cluster.md)",
    )


def cluster_address(text: str) -> str:
    """An argparse type: the address of a scheduler, with its protocol."""
    found = CLUSTER_ADDRESS.fullmatch(text)
    if found is None or not 0 < int(found["port"]) <= LAST_PORT:
        raise argparse.ArgumentTypeError(f"{text!r}, expected [tcp://|tls://]HOST:PORT")
    return f"{found['protocol'] or 'tcp://'}{found['host']}:{found['port']}"


def add_binary(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--binary",
        type=Path,
        action="append",
        default=[],
        metavar="PATH",
        help="the program px4 or arducopter, where it is neither in PATH nor built in the home folder; may be repeated",
    )


def add_port_offset(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--port-offset",
        type=whole_number(0, MAX_PORT_OFFSET),
        metavar="N",
        help="add N to all ports (default: 0, or the next multiple of 100 with which all ports are free)",
    )


def overrides_of(parsed: argparse.Namespace) -> list[str]:
    """--law and --autopilot come first: a --set of the same key wins."""
    law, autopilot = getattr(parsed, "law", None), parsed.autopilot
    short = [law_override(law)] if law else []
    short += [f"stand_in.autopilot={autopilot}"] if autopilot else []
    return [*short, *parsed.overrides]


def options_of(kind: type[Options], given: Mapping[str, Any]) -> Options:
    """A dataclass of options from the arguments that have the names of its fields."""
    return kind(**{field.name: given[field.name] for field in fields(kind) if field.name in given})
