"""`sitl completion`: a completion script of the shell."""

from __future__ import annotations

import argparse

from companion.cli.completion import DESCRIPTION, EXAMPLES, add_arguments, print_script
from companion.cli.completion import SUMMARY as HELP

MORE = EXAMPLES.format(program="sitl")
__all__ = ["DESCRIPTION", "HELP", "MORE", "add_arguments", "run"]


def run(parsed: argparse.Namespace) -> int:
    from sitl.cli.main import parser

    return print_script(parser, parsed.shell)
