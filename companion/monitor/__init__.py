"""The live page of a fleet: its server, its interface for programs, and the page itself."""

from companion.types.errors import RefusedCommandError


class MonitorError(RefusedCommandError):
    """The monitor cannot run as requested. str() is one line with what to do."""
