"""Intervals of time in which a condition held."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from companion.report.arrays import Anything, Bools, Floats

HELD_S = 0.1  # a sample counts until the next one, at most for this time: gaps of a recording are no evidence


class Interval(NamedTuple):
    begins_s: float
    ends_s: float

    @property
    def lasts_s(self) -> float:
        return self.ends_s - self.begins_s


class Sample(NamedTuple):
    """An interval with the rows of its first and last sample."""

    interval: Interval
    first: int
    last: int


def runs(time_s: Floats, holds: Bools, apart_s: float = 0.0, held_s: float = HELD_S) -> list[Sample]:
    """The intervals in which a condition (n,) held; those with at most `apart_s` between them count as one."""
    rows = np.flatnonzero(holds)
    if not rows.size:
        return []
    after = np.append(time_s[1:], np.inf)
    until_s = np.minimum(after, time_s + held_s)
    split = np.flatnonzero(time_s[rows[1:]] - until_s[rows[:-1]] > apart_s + 1e-9) + 1
    found = []
    for part in np.split(rows, split):
        first, last = int(part[0]), int(part[-1])
        end_s = min(until_s[last], time_s[-1]) if last < time_s.size - 1 else time_s[-1]
        found.append(Sample(Interval(float(time_s[first]), float(end_s)), first, last))
    return found


def stretches(time_s: Floats, values: Anything) -> list[tuple[Interval, Any]]:
    """The intervals of equal values (n,), one after the other."""
    if not time_s.size:
        return []
    begins = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
    ends = np.append(time_s[begins[1:]], time_s[-1])
    return [
        (Interval(float(time_s[row]), float(end_s)), values[row].item())
        for row, end_s in zip(begins, ends, strict=True)
    ]
