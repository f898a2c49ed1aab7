"""The live page of a fleet: its server, its interface for programs, and the page itself."""

import re

from companion.types.errors import RefusedCommandError
from companion.types.values import FLEET_NAME, quoted


class MonitorError(RefusedCommandError):
    """The monitor cannot run as requested. str() is one line with what to do."""


def check_fleet_name(name: str) -> None:
    """Raises MonitorError for a name that no fleet file may have, and that is not * for every fleet."""
    if name != "*" and not re.fullmatch(FLEET_NAME, name):
        raise MonitorError(
            f"--fleet {quoted(name)}: expected the name in a fleet file, like platoon, or * for every fleet"
        )
