"""Types and options that several commands share. Light to import."""

from __future__ import annotations

import argparse
import os
import re
import sys
from pathlib import Path
from typing import Any, NoReturn

EXIT_USAGE = 2
MAX_VEHICLE_ID = 250
MAX_WAIT_FOR_AUTOPILOT_S = 3600.0


class Help(argparse.RawDescriptionHelpFormatter):
    """As wide as the terminal. argparse would ask `shutil`, which takes 1 MB of an agent's memory."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, width=_columns() - 2)


def _columns() -> int:
    """Of the terminal; COLUMNS where it is set, 80 without a terminal."""
    columns = os.environ.get("COLUMNS", "")
    if columns.isdecimal() and int(columns) > 0:
        return int(columns)
    try:
        return os.get_terminal_size(sys.stdout.fileno()).columns or 80
    except (AttributeError, ValueError, OSError):
        return 80


class LineParser(argparse.ArgumentParser):
    """Reports an argument that cannot be used in one line, without the usage text above it.

    An unknown one is reported by the parser of the command, whose help explains it, and not by that of the whole program.
    """

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Ends the program where an argument is unknown."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return parsed, unknown

    def error(self, message: str) -> NoReturn:
        """Ends the program with EXIT_USAGE."""
        from companion.types.values import printable

        self.exit(EXIT_USAGE, f"{self.prog}: {printable(message)}; {self.prog} --help explains it\n")


def add_overrides(parser: argparse.ArgumentParser, what: str) -> None:
    """--set; its help says `what` one of them does."""
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help=f"{what}; may be given many times",
    )


def number(text: str, expected: str, least: float, most: float) -> float:
    """A number from `least` to `most`. Raises argparse.ArgumentTypeError, which names what was `expected`."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
    return value


def seconds(text: str) -> float:
    """Seconds above 0. Raises argparse.ArgumentTypeError."""
    return number(text, "seconds above 0, up to 3600", 1e-6, MAX_WAIT_FOR_AUTOPILOT_S)


def vehicle_id(text: str) -> int:
    """A MAVLink system id of a vehicle. Raises argparse.ArgumentTypeError."""
    if not re.fullmatch("[0-9]{1,3}", text) or not 1 <= int(text) <= MAX_VEHICLE_ID:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a vehicle id from 1 to {MAX_VEHICLE_ID}")
    return int(text)


def operator(text: str) -> str:
    """The name of an operator. Raises argparse.ArgumentTypeError."""
    from companion.types.commands import OPERATOR, OPERATOR_WORDS

    if not re.fullmatch(OPERATOR, text):
        raise argparse.ArgumentTypeError(f"{text!r}, expected {OPERATOR_WORDS}")
    return text


def add_vehicle_file(parser: argparse.ArgumentParser, required: bool = True) -> None:
    """--config and --wait-s, for commands that connect to an autopilot."""
    parser.add_argument("--config", type=Path, required=required, metavar="FILE", help="the vehicle file (YAML)")
    parser.add_argument(
        "--wait-s", type=seconds, default=15.0, metavar="S", help="how long to wait for the autopilot (default 15)"
    )


def add_identity(parser: argparse.ArgumentParser) -> None:
    """--identity, for programs of the ground."""
    parser.add_argument(
        "--identity",
        type=Path,
        metavar="DIR",
        help="folder of the own certificate, made by companion provision (default: COMPANION_IDENTITY, else that of the"
        " current fleet, else none: vehicles that need one are not reached)",
    )


def fail(line: str, exit_code: int) -> int:
    """Prints the line on standard error, without control characters of foreign text; returns the exit code."""
    from companion.types.values import printable_lines

    print(printable_lines(line), file=sys.stderr)
    return exit_code
