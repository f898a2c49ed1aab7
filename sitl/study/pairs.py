"""Flights with noise, each flown twice under the same noise: with the step and at rest. What differs is the step's alone.

The estimators' errors, and which packets are lost, come out of the seed and of nothing that the vehicles do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from msgspec import Struct

from companion.core.arrays import FloatArray
from companion.core.settling import SETTLED_WITHIN_M
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.study.cases import Case, Figures, figures_of, settled_s
from sitl.workers import tell

BAND_MARGIN_M = 0.05  # above the largest error that was seen without any step


class Pair(Struct, frozen=True, kw_only=True):
    """One case under one seed, with the step and without.

    `transient_s`: from when on nobody is farther than SETTLED_WITHIN_M from where the flight at rest has it, moved by the step.
    `rest_error_m`: the largest error of any vehicle at rest.
    """

    step: Figures
    rest: Figures
    rest_error_m: float
    transient_s: float | None


@dataclass(frozen=True, slots=True)
class FlownPair:
    """A pair before the band is known that its flights settle into; `*_worst_m` (ticks,) are the largest errors."""

    pair: Pair
    times_s: FloatArray
    step_worst_m: FloatArray
    rest_worst_m: FloatArray

    def into(self, band_m: float) -> Pair:
        return Pair(
            step=_into(band_m, self.pair.step, self.times_s, self.step_worst_m),
            rest=_into(band_m, self.pair.rest, self.times_s, self.rest_worst_m),
            rest_error_m=self.pair.rest_error_m,
            transient_s=self.pair.transient_s,
        )


def fly_pairs(cases: Sequence[Case], duration_s: float) -> list[FlownPair]:
    """Cases of one shape, and each of them at rest, together."""
    flown = [*cases, *(replace(case, step_m=0.0) for case in cases)]
    flight = fly_batch([case.scenario() for case in flown], duration_s, lambda flown_s: tell(flown_s / duration_s))
    worst_m = flight.errors_m().max(axis=2)
    figures = [figures_of(case, flight, worst_m[:, k], k, SETTLED_WITHIN_M) for k, case in enumerate(flown)]
    return [
        FlownPair(
            pair=Pair(
                step=figures[k],
                rest=figures[k + len(cases)],
                rest_error_m=round(float(worst_m[:, k + len(cases)].max()), 4),
                transient_s=_transient_s(flight, k, k + len(cases)),
            ),
            times_s=flight.times_s,
            step_worst_m=worst_m[:, k],
            rest_worst_m=worst_m[:, k + len(cases)],
        )
        for k in range(len(cases))
    ]


def band_m(flown: Sequence[FlownPair]) -> float:
    """That all of these can settle into: the largest error of any at rest, and a margin."""
    return round(max(one.pair.rest_error_m for one in flown) + BAND_MARGIN_M, 3)


def _transient_s(flight: BatchFlight, step: int, rest: int) -> float | None:
    references = np.broadcast_to(
        flight.reference_of_formations_enu_m(), (flight.times_s.size, flight.positions_enu_m.shape[1], 3)
    )
    moved = flight.positions_enu_m[:, step].astype(np.float64) - flight.positions_enu_m[:, rest]
    moved -= (references[:, step] - references[:, rest])[:, None, :]
    return settled_s(flight.times_s, np.linalg.norm(moved, axis=2).max(axis=1), SETTLED_WITHIN_M)


def _into(within_m: float, figures: Figures, times_s: FloatArray, worst_m: FloatArray) -> Figures:
    return msgspec.structs.replace(figures, within_m=within_m, settle_s=settled_s(times_s, worst_m, within_m))
