"""When a change begins that all vehicles make at once: by the fleet's own time, which each of them counts and tells."""

from __future__ import annotations

from collections.abc import Iterable

from companion.types import Status

AHEAD_S = 1.0  # from the command to the first movement: time for every vehicle to get it


def fleet_time_s(statuses: Iterable[Status]) -> float:
    """How far into the RFT the fleet is, by what these vehicles last said; it stands while no leader is in formation."""
    return max(status.reference_s for status in statuses)
