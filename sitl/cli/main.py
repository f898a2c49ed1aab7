"""The `sitl` command: one module of this package per subcommand, each with HELP, DESCRIPTION, MORE, arguments and run."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import NoReturn, Protocol

from companion import __version__
from companion.cli.ending import ending_quietly
from companion.cli.options import LineParser


class Subcommand(Protocol):
    """A module of this package. It is light to import: `run` imports what flies."""

    HELP: str
    DESCRIPTION: str
    MORE: str

    def add_arguments(self, parser: argparse.ArgumentParser, /) -> None: ...

    def run(self, parsed: argparse.Namespace, /) -> int: ...


def main() -> NoReturn:
    with ending_quietly():
        sys.exit(_main())


def _main() -> int:
    """The exit code. Slow imports are made here, where Ctrl-C is handled."""
    from sitl.cli.ending import exit_code_of
    from sitl.cli.needed import check_installed

    arguments = parser().parse_args()
    run: Callable[[argparse.Namespace], int] = arguments.run

    def installed_and_run() -> int:
        check_installed(arguments.command)
        return run(arguments)

    return exit_code_of(installed_and_run)


def parser() -> argparse.ArgumentParser:
    from sitl.cli import autopilot, completion, fleet, fly, gauntlet, new, paper, run, study, sweep, switching

    whole = LineParser(prog="sitl", description="Stand-in vehicles, and whole fleets of real processes.")
    whole.add_argument("--version", action="version", version=f"sitl {__version__}")
    subparsers = whole.add_subparsers(dest="command", required=True, metavar="COMMAND")
    subcommands: dict[str, Subcommand] = {
        "new": new,
        "autopilot": autopilot,
        "fly": fly,
        "fleet": fleet,
        "run": run,
        "paper": paper,
        "sweep": sweep,
        "study": study,
        "switching": switching,
        "gauntlet": gauntlet,
        "completion": completion,
    }
    for name, module in subcommands.items():
        subparser = subparsers.add_parser(
            name,
            help=module.HELP,
            description=module.DESCRIPTION,
            formatter_class=argparse.RawDescriptionHelpFormatter,
            epilog=module.MORE,
        )
        module.add_arguments(subparser)
        subparser.set_defaults(run=module.run)
    return whole
