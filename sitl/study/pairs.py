"""Flights with noise, each flown twice with the same noise: with the step and at rest. They differ by the effect of the step.

Estimator errors and packet losses depend on the seed alone, not on the motion of the vehicles.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import msgspec
import numpy as np
from msgspec import Struct

from companion.analysis.interaction import FloatArray
from companion.analysis.prediction import SETTLED_WITHIN_M
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.study.cases import Case, Figures, figures_of, settled_s
from sitl.workers import report_progress

BAND_MARGIN_M = 0.05  # above the largest error at rest


class Pair(Struct, frozen=True, kw_only=True):
    """One case with one seed, with the step and at rest.

    `transient_s`: time after which all vehicles stay within SETTLED_WITHIN_M of the flight at rest, shifted by the step.
    `rest_error_m`: largest error of any vehicle at rest.
    """

    step: Figures
    rest: Figures
    rest_error_m: float
    transient_s: float | None


@dataclass(frozen=True, slots=True)
class FlownPair:
    """A pair before the band for its settle times is known. `*_worst_m` (ticks,) are the largest errors over time."""

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
    """Fly cases of one shape, and each of them at rest, in one batch."""
    flown = [*cases, *(replace(case, step_m=0.0) for case in cases)]
    flight = fly_batch(
        [case.scenario() for case in flown], duration_s, lambda flown_s: report_progress(flown_s / duration_s)
    )
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
    """The band that all flights can settle into: the largest error at rest plus a margin."""
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
