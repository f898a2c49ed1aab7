"""Statistics of flown cells: medians with bootstrap intervals, who wins where, and how near the agents come to a batch.

Flights of different laws with the same place and seed are pairs: the same graph, the same random errors. A flight that never
settled counts as later than all that did.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import inf, isfinite, nan

import numpy as np
from msgspec import Struct

from companion.analysis.interaction import FloatArray
from sitl.batch.columns import IntArray
from sitl.compare.figures import Figures
from sitl.compare.plan import Cell, CellFlight, Place

RESAMPLES, RESAMPLING_SEED = 2000, 1
OUTSIDE = 0.025  # on each side of an interval of 95 %
FEWEST_SEEDS = 5  # with fewer an interval says nothing about other seeds
NEAR = 0.05  # share within which a figure of the agents is that of the batch


@dataclass(frozen=True, slots=True)
class Meaning:
    """A figure in tables: its label with the unit, digits, whether more is better, and a difference that is none."""

    label: str
    digits: int
    more_is_better: bool
    nothing: float


MEANINGS: dict[str, Meaning] = {
    "settle_s": Meaning("settled to 10 cm [s]", 1, False, 0.1),
    "overshoot_m": Meaning("overshoot [m]", 2, False, 0.01),
    "smallest_distance_m": Meaning("smallest distance [m]", 2, True, 0.02),
    "gain_per_hop": Meaning("gain per hop", 2, False, 0.02),
    "rms_m": Meaning("RMS about the RFT [m]", 3, False, 0.01),
    "final_error_m": Meaning("final error [m]", 3, False, 0.01),
    "effort_m_s2": Meaning("control effort [m/s²]", 2, False, 0.02),
    "bytes_per_s": Meaning("published [bytes/s]", 0, False, 1.0),
    "connected_share": Meaning("time connected", 2, True, 0.02),
}


@dataclass(frozen=True, slots=True)
class FlownFlight:
    """One flight and its figures."""

    flight: CellFlight
    figures: Figures


class MedianInterval(Struct, frozen=True, kw_only=True):
    """A median with its interval of 95 %. None: later than all that settled."""

    median: float | None
    low: float | None
    high: float | None


class CellSummary(Struct, frozen=True, kw_only=True):
    """The figures of one law in one place. Those that its flights do not have are left out, and flights that have failed."""

    law: str
    place: str
    flights: int
    failed: int
    settled_share: float
    figures: dict[str, MedianInterval]


class Winner(Struct, frozen=True, kw_only=True):
    """The best law in one place by one figure, and the next.

    `ahead` is the median of the paired differences, in favour of the best. `clear`: its interval of 95 % excludes zero.
    """

    place: str
    figure: str
    law: str
    next_law: str
    ahead: MedianInterval
    clear: bool


class Checked(Struct, frozen=True, kw_only=True):
    """One figure of one flight, by a batch and by the agents.

    `random`: the flight has random errors, others in each of the two. `agrees`: see docs/statistics.md.
    """

    law: str
    place: str
    figure: str
    batch: float | None
    agents: float | None
    random: bool
    agrees: bool


ByCell = dict[Cell, list[FlownFlight]]


def by_cell(flown: Sequence[FlownFlight]) -> ByCell:
    """In the order of the flights."""
    found: ByCell = {}
    for one in flown:
        found.setdefault(one.flight.cell, []).append(one)
    return found


def summaries(cells: ByCell) -> list[CellSummary]:
    return [_summary(cell, flown) for cell, flown in cells.items()]


def _summary(cell: Cell, flown: Sequence[FlownFlight]) -> CellSummary:
    settled = sum(one.figures.settle_s is not None for one in flown)
    found = {name: values_of(complete(flown), name) for name in MEANINGS}
    return CellSummary(
        law=cell.law,
        place=cell.place.name,
        flights=len(flown),
        failed=sum(one.figures.failure is not None for one in flown),
        settled_share=round(settled / len(flown), 4),
        figures={
            name: interval(values[~np.isnan(values)]) for name, values in found.items() if not np.isnan(values).all()
        },
    )


def complete(flown: Sequence[FlownFlight]) -> list[FlownFlight]:
    """Those that have not failed."""
    return [one for one in flown if one.figures.failure is None]


def values_of(flown: Sequence[FlownFlight], name: str) -> FloatArray:
    """The figure of each flight; infinite where it never settled, NaN where it has not this figure."""
    missing = inf if name == "settle_s" else nan
    values = (getattr(one.figures, name) for one in flown)
    return np.array([missing if value is None else value for value in values], dtype=float)


def interval(values: FloatArray) -> MedianInterval:
    """Of at least one value, by resampling with a fixed seed."""
    medians = np.sort(np.median(values[_resampled(len(values))], axis=1))
    outside = int(OUTSIDE * RESAMPLES)
    return MedianInterval(
        median=_number(float(np.median(values))),
        low=_number(float(medians[outside])),
        high=_number(float(medians[-1 - outside])),
    )


@lru_cache(maxsize=8)
def _resampled(count: int) -> IntArray:
    return np.random.default_rng([RESAMPLING_SEED, count]).integers(count, size=(RESAMPLES, count))


def _number(value: float) -> float | None:
    return round(value, 4) if isfinite(value) else None


def winners(cells: ByCell) -> list[Winner]:
    """By place and figure, where at least two laws have the figure and any of them is better than none.

    A law of which any flight has failed is the best nowhere in that place.
    """
    places: dict[Place, list[Cell]] = {}
    for cell, flown in cells.items():
        if len(complete(flown)) == len(flown):
            places.setdefault(cell.place, []).append(cell)
    found = (_winner(cells, own, name) for own in places.values() for name in MEANINGS)
    return [one for one in found if one is not None]


def _winner(cells: ByCell, own: Sequence[Cell], name: str) -> Winner | None:
    sign = -1.0 if MEANINGS[name].more_is_better else 1.0
    costs = {cell: _costs(cells[cell], name, sign) for cell in own}
    ranked = sorted((cell for cell in own if costs[cell]), key=lambda cell: np.median(list(costs[cell].values())))
    if len(ranked) < 2 or np.median(list(costs[ranked[0]].values())) == inf:
        return None
    best, second = costs[ranked[0]], costs[ranked[1]]
    ahead = np.array([_less(best[seed], second[seed]) for seed in sorted(best.keys() & second.keys())])
    if not len(ahead):
        return None
    between = interval(ahead)
    if between.median == 0.0:  # a tie
        return None
    clear = len(ahead) >= FEWEST_SEEDS and between.low != 0.0 and (between.low is None or between.low > 0.0)
    return Winner(
        place=own[0].place.name,
        figure=name,
        law=ranked[0].law,
        next_law=ranked[1].law,
        ahead=between,
        clear=clear,
    )


def _costs(flown: Sequence[FlownFlight], name: str, sign: float) -> dict[int, float]:
    """By seed, less is better."""
    values = values_of(flown, name)
    return {
        one.flight.seed: sign * float(value) for one, value in zip(flown, values, strict=True) if not np.isnan(value)
    }


def _less(cost: float, other: float) -> float:
    """How much less it costs than the other; both infinite is no difference."""
    return 0.0 if cost == other else other - cost


CHECKED = ("settle_s", "overshoot_m", "smallest_distance_m", "gain_per_hop", "rms_m", "effort_m_s2")


def checks(cells: ByCell, by_agents: Sequence[FlownFlight]) -> list[Checked]:
    """Each figure of each flight that was flown by both."""
    return [check for one in by_agents for check in _checks(cells.get(one.flight.cell, []), one)]


def _checks(flown: Sequence[FlownFlight], one: FlownFlight) -> Iterator[Checked]:
    same = next((other for other in flown if other.flight.seed == one.flight.seed), None)
    if same is None:
        return
    for name in CHECKED:
        batch, agents = getattr(same.figures, name), getattr(one.figures, name)
        if batch is None and agents is None and name != "settle_s":
            continue
        spread = values_of(flown, name) if not one.flight.repeats else np.array([])
        yield Checked(
            law=one.flight.cell.law,
            place=one.flight.cell.place.name,
            figure=name,
            batch=batch,
            agents=agents,
            random=not one.flight.repeats,
            agrees=_agrees(batch, agents, MEANINGS[name].nothing, spread),
        )


def _agrees(batch: float | None, agents: float | None, nothing: float, spread: FloatArray) -> bool:
    """Within NEAR; with random errors, which are others, within twice what the seeds have: of few the next is often outside."""
    if batch is None or agents is None:
        return batch is agents or bool(np.isinf(spread).any())
    known = spread[np.isfinite(spread)] if spread.size else np.array([batch])
    low, high = float(known.min()), float(known.max())
    margin = max(high - low, NEAR * abs(batch), nothing)
    return low - margin <= agents <= high + margin
