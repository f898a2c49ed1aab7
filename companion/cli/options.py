"""Types of arguments and options that several commands share. Light to import."""

from __future__ import annotations

import argparse
import re
from collections.abc import Callable
from pathlib import Path

MAX_VEHICLE_ID = 250
MAX_WAIT_FOR_AUTOPILOT_S = 3600.0
LONGEST_NUMBER = 9  # digits; Python refuses to read thousands of them


def number(expected: str, least: float, most: float) -> Callable[[str], float]:
    """An argparse type: a number from `least` to `most`. Its error names what was `expected`."""

    def read(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float("nan")
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
        return value

    return read


def whole_number(least: int, most: int, what: str = "a whole number") -> Callable[[str], int]:
    """An argparse type: a whole number from `least` to `most`. Its error names `what` was expected."""

    def read(text: str) -> int:
        is_number = text.isascii() and text.isdecimal() and len(text) <= LONGEST_NUMBER
        if not is_number or not least <= int(text) <= most:
            raise argparse.ArgumentTypeError(f"{text!r}, expected {what} from {least} to {most}")
        return int(text)

    return read


seconds = number("seconds above 0, up to 3600", 1e-6, MAX_WAIT_FOR_AUTOPILOT_S)
vehicle_id = whole_number(1, MAX_VEHICLE_ID, "a vehicle id")  # a MAVLink system id


def operator(text: str) -> str:
    """The name of an operator. Raises argparse.ArgumentTypeError."""
    from companion.types.commands import OPERATOR, OPERATOR_WORDS

    if not re.fullmatch(OPERATOR, text):
        raise argparse.ArgumentTypeError(f"{text!r}, expected {OPERATOR_WORDS}")
    return text


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


def add_json(parser: argparse.ArgumentParser, what: str) -> None:
    """--json; its help says `what` is printed."""
    parser.add_argument("--json", action="store_true", help=what)


def add_law(parser: argparse.ArgumentParser, what: str) -> None:
    """--law; its help says `what` is done with it."""
    known = "a built-in law, an installed one, or a Python file with one"
    parser.add_argument("--law", type=law_argument, metavar="LAW", help=f"{what}: {known}")


def law_argument(text: str) -> str:
    """An argparse type: the name of a law, or the path of a Python file with one."""
    from companion.config.law import PYTHON, law_names

    if text.endswith(PYTHON) or text in law_names():
        return text
    names = ", ".join(law_names())
    raise argparse.ArgumentTypeError(f"{text!r}, expected one of {names}, or the path of a Python file with a law")
