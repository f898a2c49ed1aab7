"""Percentiles of the figures of many flights, per combination."""

from __future__ import annotations

from collections.abc import Sequence
from math import inf, isfinite

from msgspec import Struct

from sitl.sweep.flights import FlightFigures
from sitl.sweep.points import Value

SCHEMA = 1


class Spread(Struct, frozen=True, kw_only=True):
    """Percentiles. None marks a flight without this figure, because it never settled."""

    p5: float | None
    median: float | None
    p95: float | None


class Combination(Struct, frozen=True, kw_only=True):
    """Statistics of all flights of one combination of the varied keys."""

    values: dict[str, Value]
    flights: int
    settled_share: float
    settle_s: Spread
    largest_neighbouring_distance_m: Spread
    smallest_neighbouring_distance_m: Spread
    smallest_distance_m: Spread
    final_error_m: Spread


class Sweep(Struct, frozen=True, kw_only=True):
    """Content of sweep.json. `complete` is false after a stop; then some flights or combinations are missing."""

    schema: int = SCHEMA
    scenario: str
    overrides: list[str]
    vehicles: int
    seconds: float
    seeds: int
    vary: dict[str, list[Value]]
    flights: int
    complete: bool
    combinations: list[Combination]


def combination(values: dict[str, Value], flown: Sequence[FlightFigures]) -> Combination:
    """Statistics of at least one flight."""
    settled = sum(figures.settle_s is not None for figures in flown)
    return Combination(
        values=values,
        flights=len(flown),
        settled_share=round(settled / len(flown), 4),
        settle_s=spread([figures.settle_s for figures in flown]),
        largest_neighbouring_distance_m=spread([figures.largest_neighbouring_distance_m for figures in flown]),
        smallest_neighbouring_distance_m=spread([figures.smallest_neighbouring_distance_m for figures in flown]),
        smallest_distance_m=spread([figures.smallest_distance_m for figures in flown]),
        final_error_m=spread([figures.final_error_m for figures in flown]),
    )


def spread(figures: Sequence[float | None]) -> Spread:
    """Percentiles with None as larger than any figure: without the unsettled flights the worst laws would look fast."""
    ordered = sorted(inf if figure is None else figure for figure in figures)
    return Spread(p5=_percentile(ordered, 0.05), median=_percentile(ordered, 0.5), p95=_percentile(ordered, 0.95))


def _percentile(ordered: Sequence[float], share: float) -> float | None:
    """Linear interpolation as in numpy, but an exact rank does not use its next value, which may be infinite."""
    rank = share * (len(ordered) - 1)
    below = int(rank)
    value = ordered[below]
    if rank > below:
        value += (ordered[below + 1] - value) * (rank - below) if isfinite(value) else 0.0
    return round(value, 4) if isfinite(value) else None
