"""Flies the plan of the study and collects the figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from msgspec import Struct

from sitl.study.cases import Figures, fly
from sitl.study.pairs import FlownPair, Pair, band_m, fly_pairs
from sitl.study.plan import (
    GOAL_SHAPES,
    Batch,
    disturbed_batches,
    drag_batches,
    long_batches,
    noisy_batches,
    quiet_batches,
)
from sitl.workers import Workers, all_results

One = TypeVar("One")
Progress = Callable[[float], None]  # share done, 0 to 1
QUIET_SHARE = 0.5  # of the run time

QUIET_S = 120.0
NOISY_S = 300.0  # the same for all flights: the largest error from noise grows with the duration
LONG_S, LONG_FULL_S = 300.0, 1500.0
SEEDS, SEEDS_FULL = 4, 16


class Study(Struct, frozen=True, kw_only=True):
    """All flights. `bands_m`: for each shape of the goals, the band that every law can settle into with default noise."""

    quiet: list[Figures]
    with_drag: list[Figures]
    noisy: list[Pair]
    disturbed: list[Pair]
    bands_m: dict[str, float]


def run_study(workers: Workers, full: bool, progress: Progress) -> Study:
    """Fly the batches without noise, then the pairs with noise."""
    seeds = SEEDS_FULL if full else SEEDS
    quiet = [*quiet_batches(full, QUIET_S), *long_batches(LONG_FULL_S if full else LONG_S)]
    single = [*quiet, *drag_batches(QUIET_S)]
    flown = all_results(
        workers, _fly_batch, single, lambda share: progress(QUIET_SHARE * share), [batch.work for batch in single]
    )
    noisy = noisy_batches(seeds, "default", NOISY_S)
    double = [*noisy, *disturbed_batches(seeds, "default", NOISY_S)]
    pairs = all_results(
        workers,
        fly_batch_of_pairs,
        double,
        lambda share: progress(QUIET_SHARE + (1.0 - QUIET_SHARE) * share),
        [batch.work for batch in double],
    )
    flown_noisy, flown_disturbed = _joined(pairs[: len(noisy)]), _joined(pairs[len(noisy) :])
    bands_m = {
        shape.name: band_m([one for one in (*flown_noisy, *flown_disturbed) if one.pair.step.shape == shape.name])
        for shape in GOAL_SHAPES
    }
    return Study(
        quiet=_joined(flown[: len(quiet)]),
        with_drag=_joined(flown[len(quiet) :]),
        noisy=[one.into(bands_m[one.pair.step.shape]) for one in flown_noisy],
        disturbed=[one.into(bands_m[one.pair.step.shape]) for one in flown_disturbed],
        bands_m=bands_m,
    )


def _joined(batches: Sequence[list[One]]) -> list[One]:
    return [one for batch in batches for one in batch]


def _fly_batch(batch: Batch) -> list[Figures]:
    return fly(batch.cases, batch.duration_s)


def fly_batch_of_pairs(batch: Batch) -> list[FlownPair]:
    return fly_pairs(batch.cases, batch.duration_s)
