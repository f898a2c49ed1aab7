"""Exit of a `sitl` command: an error that a user can cause is one line on standard error and an exit code.

A closed pipe and an early Ctrl-C are handled as for `companion`: companion/cli/ending.py.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from companion.config.file import ConfigError
from companion.types.errors import EXIT_FAILED, EXIT_UNUSABLE, FailedError, UnusableError
from sitl.stopping import StopNow


def exit_code_of(command: Callable[[], int]) -> int:
    """Run a command and return its exit code. Any other exception is a defect of the program and is raised."""
    try:
        return command()
    except FailedError as error:
        return _report(str(error), EXIT_FAILED)
    except (ConfigError, UnusableError) as error:
        return _report(str(error), EXIT_UNUSABLE)
    except StopNow as stop:
        return _report(str(stop), stop.exit_code)
    except BrokenPipeError:  # not caused by the results folder
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _report(f"{where}{error.strerror}; choose another folder with --out", EXIT_UNUSABLE)


def _report(line: str, exit_code: int) -> int:
    print(line, file=sys.stderr)
    return exit_code
