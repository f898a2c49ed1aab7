"""The `sitl` command."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn

from companion.cli import program
from companion.cli.program import Program, completion, fail
from companion.types.errors import EXIT_UNUSABLE


def main() -> NoReturn:
    """Ends the process with the exit code of the command. Slow imports are made where Ctrl-C is handled."""
    with program.end_quietly():
        sys.exit(_program().main())


def parser() -> argparse.ArgumentParser:
    """All commands with their arguments."""
    return _program().parser()


def _program() -> Program:
    """The program with its commands."""
    from sitl.cli.flights import FLEET, FLY, RUN
    from sitl.cli.stand_ins import AUTOPILOT, NEW, SCENARIOS
    from sitl.cli.studies import COMPARE, GAUNTLET, PAPER, REPLACED

    return Program(
        name="sitl",
        description="Stand-in vehicles, and whole fleets of real processes.",
        commands=(
            *(SCENARIOS, NEW, AUTOPILOT, FLY, FLEET, RUN, PAPER, COMPARE, GAUNTLET, *REPLACED),
            completion("sitl", parser),
        ),
        ending=exit_code_of,
    )


def exit_code_of(command: str, run: Callable[[], int]) -> int:
    """That of `companion`, and for a signal that stops at once and for an error of the results folder one line as well."""
    from sitl.stopping import StopNow

    try:
        return program.exit_code_of(command, run)
    except StopNow as stop:
        return fail(str(stop), stop.exit_code)
    except BrokenPipeError:  # not caused by the results folder
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return fail(f"{where}{error.strerror}; choose another folder with --out", EXIT_UNUSABLE)
