"""Errors of the commands that need the link to an autopilot, as one line and an exit code."""

from __future__ import annotations

from collections.abc import Callable

from companion.cli.options import fail

EXIT_FILE, EXIT_NO_AUTOPILOT, EXIT_DEFECT = 2, 3, 4


def exit_code_of(run: Callable[[], int]) -> int:
    """The exit code of `run`; 2 where a file or endpoint cannot be used, 3 where no autopilot answers."""
    from companion.config.file import ConfigError
    from companion.link.autopilot_link import AutopilotSilentError

    try:
        return run()
    except ConfigError as error:
        return fail(str(error), EXIT_FILE)
    except AutopilotSilentError as error:
        return fail(str(error), EXIT_NO_AUTOPILOT)
