"""Intervals of time in which a condition held."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from companion.report.arrays import Anything, Bools, Floats

HELD_S = 0.1  # a sample counts until the next one, at most for this time: gaps of a recording are no evidence
PAUSE_S = 1e-9  # less is rounding


class Interval(NamedTuple):
    begins_s: float
    ends_s: float

    @property
    def lasts_s(self) -> float:
        return self.ends_s - self.begins_s


class Episode(NamedTuple):
    """One or more stretches of time in which a condition held, from the first to the last, with the rows of its ends."""

    interval: Interval
    first: int
    last: int
    held_s: float  # without the pauses between the stretches
    longest_s: float  # of one stretch

    @property
    def duration_text(self) -> str:
        """How long it held; with pauses, also from when to when."""
        paused = self.interval.lasts_s - self.held_s > PAUSE_S
        return f"for {self.held_s:.2f} s" + (f" within {self.interval.lasts_s:.2f} s" if paused else "")


def runs(time_s: Floats, holds: Bools, apart_s: float = 0.0, held_s: float = HELD_S) -> list[Episode]:
    """The times in which a condition (n,) held; stretches with at most `apart_s` between them are one episode."""
    rows = np.flatnonzero(holds)
    if not rows.size:
        return []
    after = np.append(time_s[1:], np.inf)
    until_s = np.minimum(np.minimum(after, time_s + held_s), time_s[-1])
    pauses_s = time_s[rows[1:]] - until_s[rows[:-1]]
    return [
        _episode(time_s, until_s, part) for part in np.split(rows, np.flatnonzero(pauses_s > apart_s + PAUSE_S) + 1)
    ]


def _episode(time_s: Floats, until_s: Floats, rows: np.ndarray) -> Episode:
    """Of these rows, each of which holds until `until_s`."""
    begins = np.flatnonzero(np.append(np.inf, time_s[rows[1:]] - until_s[rows[:-1]]) > PAUSE_S)
    ends = np.append(begins[1:], rows.size) - 1
    lasts_s = until_s[rows[ends]] - time_s[rows[begins]]
    first, last = int(rows[0]), int(rows[-1])
    interval = Interval(float(time_s[first]), float(until_s[last]))
    return Episode(interval, first, last, float(lasts_s.sum()), float(lasts_s.max()))


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
