"""The fleet time, which every vehicle reports, and by which a change begins in all vehicles at once."""

from __future__ import annotations

from collections.abc import Iterable

from companion.types.status import Status

AHEAD_S = 1.0  # seconds from a command to its beginning: every vehicle has received it by then


def fleet_time_s(statuses: Iterable[Status]) -> float:
    """Time along the RFT by these reports, seconds; it does not advance while no leader is in formation."""
    return max(status.reference_s for status in statuses)
