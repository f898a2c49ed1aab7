"""Measured figures: repeats, their median, the figure beside it, the ratio of both, and the target. Pure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise
from math import atan2, ceil, cos, fsum, inf, sin, tau
from statistics import median
from typing import Literal, NamedTuple

from msgspec import Struct

EARLY = 0.05


class Target(Struct, frozen=True):
    """Limits of the median, or of its ratio to the figure beside it."""

    of: Literal["value", "ratio"]
    most: float = inf
    least: float = -inf

    def holds(self, figure: float) -> bool:
        return self.least <= figure <= self.most


class Row(Struct, frozen=True, kw_only=True):
    """One figure. `values` and `beside_values` have one value per repeat; none where it could not be measured.

    `remark` says why, or under which condition.
    """

    what: str
    unit: str
    values: tuple[float, ...]
    beside: str = ""
    beside_values: tuple[float, ...] = ()
    target: Target | None = None
    remark: str = ""

    @property
    def value(self) -> float | None:
        """Median of the repeats."""
        return median(self.values) if self.values else None

    @property
    def beside_value(self) -> float | None:
        """Median of the repeats of the other program."""
        return median(self.beside_values) if self.beside_values else None

    @property
    def ratio(self) -> float | None:
        """To the other program's figure; without one to the limit."""
        value, other = self.value, self.beside_value
        if not self.beside and self.target and self.target.of == "value":
            other = _one_limit(self.target)
        return value / other if value is not None and other else None

    @property
    def is_met(self) -> bool | None:
        """Whether the target is met; None without a target or a figure."""
        if self.target is None:
            return None
        figure = self.value if self.target.of == "value" else self.ratio
        return None if figure is None else self.target.holds(figure)


class Section(Struct, frozen=True, kw_only=True):
    """The rows of one measurement. `how` says in plain words how they are measured.

    `others_cores`: what processes outside the bench used meanwhile, in cores.
    """

    title: str
    how: str
    rows: tuple[Row, ...]
    others_cores: float = 0.0


def percentile(values: Sequence[float], share: float) -> float:
    """The smallest value that is not exceeded by this share of all. Raises ValueError without values."""
    if not values:
        raise ValueError("a percentile of no values")
    ordered = sorted(values)
    return ordered[max(0, ceil(share * len(ordered)) - 1)]


def lateness_us(times_s: Sequence[float], period_s: float) -> list[float]:
    """How much later than the early ticks of all each tick begins, on a grid of `period_s`, us.

    The phase of the grid is unknown: the EARLY share of the ticks defines it, and is not late. A tick that is more than
    three quarters of a period late counts on its next place.
    """
    if not times_s:
        return []
    angles = [tau * (time_s % period_s) / period_s for time_s in times_s]
    usual_s = atan2(fsum(map(sin, angles)), fsum(map(cos, angles))) / tau * period_s
    late_s = [(time_s - usual_s + period_s / 4.0) % period_s for time_s in times_s]
    early_s = percentile(late_s, EARLY)
    return [max(0.0, one_s - early_s) * 1e6 for one_s in late_s]


def _one_limit(target: Target) -> float | None:
    """The limit of a target with one limit."""
    limits = [limit for limit in (target.most, target.least) if abs(limit) < inf]
    return limits[0] if len(limits) == 1 else None


REPEATS = 5


class Window(NamedTuple):
    """Of CLOCK_MONOTONIC."""

    begin_s: float
    end_s: float

    @property
    def lasts_s(self) -> float:
        return self.end_s - self.begin_s


class AgentsUse(NamedTuple):
    """CPU time of each agent up to now, and its resident memory, by vehicle id."""

    at_s: float
    cpu_s: Mapping[int, float]
    memory_mb: Mapping[int, float]


def windows_of(uses: list[AgentsUse]) -> list[Window]:
    """From each sample to the next."""
    return [Window(a.at_s, b.at_s) for a, b in pairwise(uses)]


def within(window: Window, timed: Iterable[tuple[float, float]]) -> list[float]:
    """Values of (time, value) whose time lies in the window."""
    return [value for at_s, value in timed if window.begin_s <= at_s < window.end_s]


def cpu_percent(before: AgentsUse, after: AgentsUse) -> float:
    """Mean of the agents, of one core."""
    used_s = sum(after.cpu_s[i] - before.cpu_s[i] for i in before.cpu_s)
    return 100.0 * used_s / len(before.cpu_s) / (after.at_s - before.at_s)
