"""From a described RFT to a command for every vehicle that may lead: in which number, and when it begins."""

from __future__ import annotations

from collections.abc import Sequence

from companion.ground.formations import AHEAD_S, fleet_time_s
from companion.types import Described, ReferenceChange, Status


def reference_change(reference: Described, statuses: Sequence[Status]) -> ReferenceChange:
    """`reference` as a file has it; in the next number, and soon by the fleet's own time."""
    numbers = (status.reference.waiting for status in statuses if status.reference)
    return ReferenceChange(max(numbers, default=0) + 1, reference, fleet_time_s(statuses) + AHEAD_S)
