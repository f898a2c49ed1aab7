"""The offset between two clocks and its rate, from the times of messages in both directions.

A message that leaves at `sent_s` of clock a and is received at `received_s` of clock b shows that b is at most received - sent
ahead of a. Messages the other way show how far it is ahead at least. The line in the middle of this corridor is the offset, as
in NTP. It is exact where the shortest delays of both directions are equal. Otherwise it is wrong by half their difference, and
never by more than half the width of the corridor.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

MAX_RATE = 3e-4  # seconds per second; the clocks of two computers drift apart by less
RATE_NEEDS_S = 30.0  # a rate that only messages nearer to each other than this show is noise
BIN_S = 5.0  # one bound for each direction in this time
SURE = 20  # of so many messages in a bin the second best counts: one wrong time of sending must not decide
RATE_STEPS = 80  # of the search, each a third nearer


@dataclass(frozen=True, slots=True)
class ClockLine:
    """Clock b minus clock a at the time `a_s` of clock a: offset_s + rate * (a_s - at_s). `width_s` is that of the corridor."""

    at_s: float
    offset_s: float
    rate: float
    width_s: float


def fitted_line(sent_a_s: Floats, received_b_s: Floats, sent_b_s: Floats, received_a_s: Floats) -> ClockLine | None:
    """The line by the messages from a to b and from b to a; None where there are none in one direction."""
    if not len(sent_a_s) or not len(sent_b_s):
        return None
    at_s = float(np.mean(sent_a_s))
    upper_at_s, upper_s = _least(sent_a_s - at_s, received_b_s - sent_a_s)
    lower_at_s, negative_s = _least(received_a_s - at_s, received_a_s - sent_b_s)
    lower_s = -negative_s

    def corridor(rate: float) -> tuple[float, float]:
        """Highest line below and lowest line above all bounds, by their offsets at `at_s`."""
        return float(np.max(lower_s - rate * lower_at_s)), float(np.min(upper_s - rate * upper_at_s))

    rate = _widest(corridor)
    least_s, most_s = corridor(rate)
    return ClockLine(at_s, (least_s + most_s) / 2.0, rate, abs(most_s - least_s))


def _least(at_s: Floats, apart_s: Floats) -> tuple[Floats, Floats]:
    """The smallest value in each bin of time, or the second one where there are many, and its time."""
    order = np.lexsort((apart_s, np.floor(at_s / BIN_S)))
    bins = np.floor(at_s[order] / BIN_S)
    first = np.flatnonzero(np.diff(bins, prepend=np.nan) != 0)
    count = np.diff(np.append(first, len(bins)))
    chosen = order[first + (count >= SURE)]
    return at_s[chosen], apart_s[chosen]


def _widest(corridor: Callable[[float], tuple[float, float]]) -> float:
    """The rate with the widest corridor. The width is concave in the rate."""

    def width(rate: float) -> float:
        least_s, most_s = corridor(rate)
        return most_s - least_s - abs(rate) * RATE_NEEDS_S

    low, high = -MAX_RATE, MAX_RATE
    for _ in range(RATE_STEPS):
        third = (high - low) / 3.0
        if width(low + third) < width(high - third):
            low += third
        else:
            high -= third
    return (low + high) / 2.0
