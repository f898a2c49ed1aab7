"""Values of command lines, refused in words."""

from __future__ import annotations

import argparse
from pathlib import Path

COMMAND_LINE = Path("command line")  # stands where errors name a file


def number(text: str, expected: str, least: float, most: float) -> float:
    """Raises argparse.ArgumentTypeError, which says what was `expected`."""
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not least <= value <= most:
        raise argparse.ArgumentTypeError(f"{text!r}, expected {expected}")
    return value
