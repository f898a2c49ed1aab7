"""Exit codes of the `sitl` commands, and the errors that end a command with one line."""

from __future__ import annotations

EXIT_DONE, EXIT_FAILED, EXIT_UNUSABLE = 0, 1, 2


class FailedError(Exception):
    """The command could not do its work although its files and arguments are right. str() is one line."""


class UnusableError(Exception):
    """Something on this machine prevents the command, and the user can change it. str() is one line that names it."""
