"""The command line that `sitl fly` and `sitl run` share. Light to import: what flies is imported when it does."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from companion.config import LawName

LAWS: tuple[LawName, ...] = get_args(LawName)


@dataclass(frozen=True, slots=True)
class RunOptions:
    """What the command line says. `others` are the laws to compare with, None where nothing is to be compared."""

    scenario: Path
    overrides: Sequence[str] = ()
    others: Sequence[LawName] | None = None
    out: Path | None = None
    quiet: bool = False


def add_run_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenario", type=Path, metavar="SCENARIO", help="a scenario file, see config/scenarios/")
    parser.add_argument("--law", choices=LAWS, help="fly with this law (short for --set fleet.law.name=LAW)")
    parser.add_argument(
        "--compare",
        nargs="*",
        choices=LAWS,
        metavar="LAW",
        help="fly with the scenario's law, then with these (default: with all others), and compare",
    )
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        dest="overrides",
        metavar="KEY=VALUE",
        help="change one key of the scenario; may be given many times",
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="the folder for the results")
    parser.add_argument("--quiet", action="store_true", help="print the result only")


def run_options(parsed: argparse.Namespace) -> RunOptions:
    """--law comes first: a --set of the same key wins."""
    law = [f"fleet.law.name={parsed.law}"] if parsed.law else []
    others: Sequence[LawName] | None = parsed.compare
    if others is not None and not others:
        others = LAWS
    return RunOptions(parsed.scenario, [*law, *parsed.overrides], others, parsed.out, parsed.quiet)
