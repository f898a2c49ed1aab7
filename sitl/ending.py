"""How a command of `sitl` ends: whatever a user can cause is one line on standard error and an exit code.

What a closed pipe and an early Ctrl-C do is the same for `companion`: companion/ending.py.
"""

from __future__ import annotations

import sys
from collections.abc import Callable

from companion.config_file import ConfigError
from sitl.stopping import StopNow

EXIT_DONE, EXIT_FAILED, EXIT_UNUSABLE = 0, 1, 2


class FailedError(Exception):
    """What was asked for could not be done, by no fault of a file or an argument. str() is one line."""


class UnusableError(Exception):
    """Something on this machine stands in the way, and a user can change it. str() is one line that says what."""


def exit_code_of(command: Callable[[], int]) -> int:
    """Run a command to its end. What it raises besides is a mistake of its own, and shows as one."""
    try:
        return command()
    except FailedError as error:
        return _said(str(error), EXIT_FAILED)
    except (ConfigError, UnusableError) as error:
        return _said(str(error), EXIT_UNUSABLE)
    except StopNow as stop:
        return _said(str(stop), stop.exit_code)
    except BrokenPipeError:  # no folder's fault
        raise
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _said(f"{where}{error.strerror}; choose another folder with --out", EXIT_UNUSABLE)


def _said(line: str, exit_code: int) -> int:
    print(line, file=sys.stderr)
    return exit_code
