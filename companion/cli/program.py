"""The command line of a program, `companion` or `sitl`: its commands, its parser, and how a command ends.

A command ends with its exit code; an error of `companion/types/errors.py` is one line on standard error and the exit code
of its class. Ctrl-C ends with a line, a closed pipe without one: `companion ... | head` ends as `yes | head` does. Any other
exception is a defect and has a traceback.
"""

from __future__ import annotations

import argparse
import os
import re
import select
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from inspect import cleandoc
from pathlib import Path
from typing import Any, NoReturn

from companion import GROUND_INSTALL, __version__
from companion.types.errors import EXIT_UNUSABLE, EndingError, UnusableError

EXIT_INTERRUPTED = 130
EXIT_READER_GONE = 141  # as shells count: 128 and SIGPIPE's number
STDOUT, STDERR = 1, 2
OWN = ("", "companion", "sitl", "tests")  # an import inside these that fails is a defect
SHELLS = ("bash", "zsh")
FILES_OF_SHELLS = {"bash": "_shtab_compgen_files", "zsh": "_files"}


@dataclass(frozen=True, slots=True)
class CliCommand:
    """A command: its help, its arguments, and `run`, which returns the exit code and imports what it needs.

    `summary` is its line in the help of the program; `more` has its examples and exit codes; `needs` are packages beyond
    the base install.
    """

    name: str
    summary: str
    description: str
    more: str
    add_arguments: Callable[[argparse.ArgumentParser], None]
    run: Callable[[argparse.Namespace], int]
    needs: tuple[str, ...] = ()

    def check_installed(self, program: str) -> None:
        """To be called before `run`. Raises UnusableError, which names the packages that are missing."""
        missing = [package for package in self.needs if not find_spec(package)]
        if missing:
            verb = "is" if len(missing) == 1 else "are"
            raise UnusableError(f"{program} {self.name}: {', '.join(missing)} {verb} not installed; {GROUND_INSTALL}")


def command(
    name: str,
    summary: str,
    add_arguments: Callable[[argparse.ArgumentParser], None],
    run: Callable[[argparse.Namespace], int],
    needs: tuple[str, ...] = (),
    after: str = "examples:",
) -> CliCommand:
    """The command that `run` carries out, whose docstring is the help: from the paragraph on that begins with the text
    `after` it follows the arguments. `needs` as in CliCommand.
    """
    description, begun, more = cleandoc(run.__doc__ or "").partition(f"\n\n{after}")
    return CliCommand(name, summary, f"{description}\n", f"{begun.lstrip()}{more}\n", add_arguments, run, needs)


def exit_code_of(command: str, run: Callable[[], int]) -> int:
    """What `run` returns, or the exit code of an EndingError after its line. `command` is that of the line."""
    try:
        return run()
    except EndingError as error:
        return fail(error.line(command), error.exit_code)


@dataclass(frozen=True, slots=True)
class Program:
    """A program with its commands, which are light to import: the agent stays small.

    `title` stands above the commands in the help, `more` at its end. `ending` runs a command and returns its exit code.
    """

    name: str
    description: str
    commands: tuple[CliCommand, ...]
    title: str | None = None
    more: str | None = None
    ending: Callable[[str, Callable[[], int]], int] = exit_code_of

    def main(self, arguments: Sequence[str] | None = None) -> int:
        """The exit code of the command that the arguments name; without them that of the process's own."""
        words = sys.argv[1:] if arguments is None else arguments
        command = next((word for word in words if not word.startswith("-")), None)
        with end_quietly():
            options = self.parser(command).parse_args(words)
            return self.ending(f"{self.name} {options.command}", lambda: self._run(options))

    def _run(self, options: argparse.Namespace) -> int:
        chosen: CliCommand = options.chosen
        chosen.check_installed(self.name)
        try:
            return chosen.run(options)
        except ImportError as error:
            package = (error.name or "").partition(".")[0]
            if package in OWN or package in sys.stdlib_module_names:
                raise
            reason = "is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be used: {error}"
            raise UnusableError(f"{self.name} {chosen.name}: {package} {reason}; {GROUND_INSTALL}") from error

    def parser(self, only: str | None = None) -> argparse.ArgumentParser:
        """All commands, with their arguments. With `only` that command alone has them: the others would load modules."""
        made = LineParser(prog=self.name, description=self.description, epilog=self.more, formatter_class=Help)
        made.add_argument("--version", action="version", version=f"{self.name} {__version__}")
        titled = {} if self.title is None else {"title": self.title}
        commands = made.add_subparsers(dest="command", required=True, metavar="COMMAND", **titled)
        for command in self.commands:
            one = commands.add_parser(
                command.name,
                help=command.summary,
                description=command.description,
                epilog=command.more,
                formatter_class=Help,
            )
            if only in (None, command.name):
                command.add_arguments(one)
            one.set_defaults(chosen=command)
        return made


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


NEGATIVE_NUMBER = re.compile(r"-(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)


class LineParser(argparse.ArgumentParser):
    """Reports an argument that cannot be used in one line, without the usage text above it.

    An unknown one is reported by the parser of the command, whose help explains it, and not by that of the whole program.
    Each negative number is a value: argparse itself takes -33. and -3.6e-16 for options.
    """

    def _parse_optional(self, arg_string: str) -> Any:
        return None if NEGATIVE_NUMBER.fullmatch(arg_string) else super()._parse_optional(arg_string)

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> tuple[Any, list[str]]:
        """Ends the program where an argument is unknown."""
        parsed, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unrecognized arguments: {' '.join(unknown)}")
        return parsed, unknown

    def error(self, message: str) -> NoReturn:
        """Ends the program with EXIT_UNUSABLE."""
        from companion.types.values import printable

        self.exit(EXIT_UNUSABLE, f"{self.prog}: {printable(message)}; {self.prog} --help explains it\n")


def fail(line: str, exit_code: int) -> int:
    """Prints the line on standard error, without control characters of foreign text; returns the exit code."""
    from companion.types.values import printable_lines

    print(printable_lines(line), file=sys.stderr)
    return exit_code


@contextmanager
def end_quietly() -> Iterator[None]:
    """Around a whole command. A broken pipe that is not standard output or error stays an error."""
    try:
        try:
            yield
        except KeyboardInterrupt:  # a command handles it itself; this one came before or after
            print("interrupted", file=sys.stderr)
            sys.exit(EXIT_INTERRUPTED)
        finally:
            sys.stdout.flush()  # here: at the exit of Python the error could not be caught
    except BrokenPipeError:
        closed = [number for number in (STDOUT, STDERR) if _reader_has_gone(number)]
        if not closed:
            raise
        for number in closed:
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)  # for what is still buffered
        sys.exit(EXIT_READER_GONE)


def _reader_has_gone(number: int) -> bool:
    poll = select.poll()
    poll.register(number, 0)  # errors are always reported
    return any(events & select.POLLERR for _, events in poll.poll(0))


def completion(program: str, make_parser: Callable[[], argparse.ArgumentParser]) -> CliCommand:
    """The command that prints a completion script for a shell, made from the program's parser by shtab."""

    def run(options: argparse.Namespace) -> int:
        try:
            import shtab
        except ImportError as error:
            raise UnusableError(f"{program} completion: shtab is not installed; {GROUND_INSTALL}") from error
        parser = make_parser()
        _complete_files(parser)
        print(shtab.complete(parser, options.shell))
        return 0

    def add_arguments(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("shell", choices=SHELLS, metavar="SHELL", help=", ".join(SHELLS))

    return CliCommand(
        "completion",
        "prints a completion script for bash or zsh",
        "Print a completion script for a shell: commands, options, choices and file names.",
        f"""\
examples:
  source <({program} completion bash)                                   in ~/.bashrc
  {program} completion zsh > ~/.zfunc/_{program}                         with ~/.zfunc in $fpath, before compinit
""",
        add_arguments,
        run,
    )


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Marks every argument that is a path, in all subcommands."""
    for action in parser._actions:
        marked: Any = action
        if isinstance(action, argparse._SubParsersAction):
            for inner in action.choices.values():
                _complete_files(inner)
        elif action.type is Path:
            marked.complete = FILES_OF_SHELLS
