"""The `companion` command."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from companion.cli.agent import AGENT
from companion.cli.analyze import ANALYZE, EXPLAIN
from companion.cli.fleet import FLEET
from companion.cli.init import INIT
from companion.cli.law import LAW
from companion.cli.mocap import MOCAP
from companion.cli.monitor import MONITOR
from companion.cli.program import Program, completion
from companion.cli.provision import PROVISION
from companion.cli.recordings import EXPORT, REPLAY, REPORT
from companion.cli.vehicle import DOCTOR, LOGS


def main(arguments: Sequence[str] | None = None) -> int:
    """The exit code; `companion --help` explains it."""
    return PROGRAM.main(arguments)


def parser() -> argparse.ArgumentParser:
    """All commands with their arguments."""
    return PROGRAM.parser()


PROGRAM = Program(
    name="companion",
    description="Formation flight for quadrotors with an onboard computer.",
    commands=(
        *(AGENT, DOCTOR, LOGS, FLEET, MONITOR, MOCAP, REPORT, REPLAY, EXPORT),
        *(ANALYZE, EXPLAIN, LAW, INIT, PROVISION, completion("companion", parser)),
    ),
    title="commands",
    more="`companion COMMAND --help` shows examples and exit codes.",
)
