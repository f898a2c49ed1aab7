"""`companion completion` and `sitl completion`: a completion script of the shell, made from the parser by shtab."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

from companion import GROUND_INSTALL
from companion.cli.options import fail

NAME = "completion"
SUMMARY = "prints a completion script for bash or zsh"
SHELLS = ("bash", "zsh")
EXIT_UNUSABLE = 2
DESCRIPTION = "Print a completion script for a shell: commands, options, choices and file names."
EXAMPLES = """\
examples:
  source <({program} completion bash)                                   in ~/.bashrc
  {program} completion zsh > ~/.zfunc/_{program}                         with ~/.zfunc in $fpath, before compinit
"""
MORE = EXAMPLES.format(program="companion")
FILES = {"bash": "_shtab_compgen_files", "zsh": "_files"}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))


def run(options: argparse.Namespace) -> int:
    """The exit code."""
    from companion.cli.main import parser

    return print_script(parser, options.shell)


def print_script(make_parser: Callable[[], argparse.ArgumentParser], shell: str) -> int:
    """The exit code."""
    parser = make_parser()
    try:
        import shtab
    except ImportError:
        return fail(f"{parser.prog} completion: shtab is not installed; {GROUND_INSTALL}", EXIT_UNUSABLE)
    _complete_files(parser)
    print(shtab.complete(parser, shell))
    return 0


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Marks every argument that is a path, in all subcommands."""
    for action in parser._actions:
        marked: Any = action
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _complete_files(inner)
        elif action.type is Path:
            marked.complete = FILES
