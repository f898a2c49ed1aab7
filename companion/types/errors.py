"""The base of all exceptions of this project, and those that end a command with one line and an exit code.

`companion/cli/program.py` shows them. Any other exception that ends a command is a defect, and has a traceback.
"""

from __future__ import annotations

from typing import ClassVar

EXIT_DONE, EXIT_FAILED, EXIT_UNUSABLE, EXIT_NO_AUTOPILOT, EXIT_DEFECT = range(5)


class CompanionError(Exception):
    """An error that this project raises. str() says in one line what is wrong, where one can do something also what to do."""


class EndingError(CompanionError):
    """Ends a command with `line` on standard error and `exit_code`."""

    exit_code: ClassVar[int]

    def line(self, command: str) -> str:  # noqa: ARG002 -- for those that name it
        """The line on standard error. `command` is the one that ends, like `companion monitor`."""
        return str(self)


class FailedError(EndingError):
    """The command could not do its work although its files and arguments are right."""

    exit_code = EXIT_FAILED


class UnusableError(EndingError):
    """A file, an argument or something on this machine prevents the command, and the user can change it. str() names it."""

    exit_code = EXIT_UNUSABLE


class RefusedCommandError(UnusableError):
    """The same with a text that does not name what it is about: the line begins with the command."""

    def line(self, command: str) -> str:
        return f"{command}: {self}"
