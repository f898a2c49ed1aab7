"""Windows of time within one flight: each is one repeat."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import NamedTuple

REPEATS = 5


class Window(NamedTuple):
    """Of CLOCK_MONOTONIC."""

    begin_s: float
    end_s: float

    @property
    def lasts_s(self) -> float:
        return self.end_s - self.begin_s


class Use(NamedTuple):
    """CPU time of each agent up to now, and its resident memory, by vehicle id."""

    at_s: float
    cpu_s: Mapping[int, float]
    memory_mb: Mapping[int, float]


def windows_of(uses: list[Use]) -> list[Window]:
    """From each sample to the next."""
    return [Window(a.at_s, b.at_s) for a, b in pairwise(uses)]


def within(window: Window, timed: Iterable[tuple[float, float]]) -> list[float]:
    """Values of (time, value) whose time lies in the window."""
    return [value for at_s, value in timed if window.begin_s <= at_s < window.end_s]


def cpu_percent(before: Use, after: Use) -> float:
    """Mean of the agents, of one core."""
    used_s = sum(after.cpu_s[i] - before.cpu_s[i] for i in before.cpu_s)
    return 100.0 * used_s / len(before.cpu_s) / (after.at_s - before.at_s)
