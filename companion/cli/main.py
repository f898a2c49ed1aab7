"""The `companion` command. Each command is a module that imports what it needs when it runs: the agent stays small."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence

from companion import __version__
from companion.cli import (
    agent,
    analyze,
    completion,
    doctor,
    explain,
    export,
    fleet,
    init,
    logs,
    monitor,
    provision,
    replay,
    report,
)
from companion.cli.ending import ending_quietly
from companion.cli.options import Help, LineParser

# A command module has NAME, SUMMARY (one line), DESCRIPTION and MORE (its help), add_arguments(parser) and run(options).
COMMANDS = (agent, doctor, logs, fleet, monitor, report, replay, export, analyze, explain, init, provision, completion)

DESCRIPTION = "Formation flight for quadrotors with an onboard computer."


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code; `companion --help` explains it."""
    words = sys.argv[1:] if arguments is None else arguments
    command = next((word for word in words if not word.startswith("-")), None)
    with ending_quietly():
        options = parser(command).parse_args(words)
        run: Callable[[argparse.Namespace], int] = options.run
        return run(options)


def parser(only: str | None = None) -> argparse.ArgumentParser:
    """All commands, with their arguments. With `only` that command alone has its arguments: the others would load modules."""
    made = LineParser(
        prog="companion",
        description=DESCRIPTION,
        epilog="`companion COMMAND --help` shows examples and exit codes.",
        formatter_class=Help,
    )
    made.add_argument("--version", action="version", version=f"companion {__version__}")
    commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND", title="commands")
    for command in COMMANDS:
        one = commands.add_parser(
            command.NAME,
            help=command.SUMMARY,
            description=command.DESCRIPTION,
            epilog=command.MORE,
            formatter_class=Help,
        )
        if only in (None, command.NAME):
            command.add_arguments(one)
        one.set_defaults(run=command.run)
    return made
