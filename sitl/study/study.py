"""Flies the plan of the study on all cores and gathers its figures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from msgspec import Struct

from sitl.study.cases import Figures, fly
from sitl.study.plan import (
    Batch,
    disturbed_batches,
    drag_batches,
    long_batches,
    noisy_batches,
    quiet_batches,
    still_batches,
)
from sitl.workers import in_processes

Progress = Callable[[float], None]  # share done, 0 to 1
BAND_MARGIN_M = 0.05  # above the largest error that was seen without any step

QUIET_S, STILL_S, NOISY_S = 120.0, 60.0, 120.0
LONG_S, LONG_FULL_S = 300.0, 1500.0  # the second sees even eq. 22 settle a chain of 16
SEEDS, SEEDS_FULL = 4, 16


class Study(Struct, frozen=True, kw_only=True):
    """All flights. `bands_m`: for each of the goals' shapes, the band that default noise allows."""

    quiet: list[Figures]
    with_drag: list[Figures]
    still: list[Figures]
    noisy: list[Figures]
    disturbed: list[Figures]
    bands_m: dict[str, float]


def run_study(full: bool, progress: Progress) -> Study:
    """In three rounds: without noise; with noise and no step, which gives the bands; with noise, step and bad links."""
    seeds = SEEDS_FULL if full else SEEDS
    quiet = [*quiet_batches(full, QUIET_S), *long_batches(LONG_FULL_S if full else LONG_S)]
    with_drag = drag_batches(QUIET_S)
    still = still_batches(seeds, "default", STILL_S)
    first = _fly_all([*quiet, *with_drag, *still], lambda share: progress(0.6 * share))
    flown_quiet, rest = first[: len(quiet)], first[len(quiet) :]
    flown_drag, flown_still = rest[: len(with_drag)], rest[len(with_drag) :]
    bands_m = {
        batch[0].shape: round(max(figures.late_error_m for figures in batch) + BAND_MARGIN_M, 3)
        for batch in flown_still
    }
    noisy = noisy_batches(bands_m, seeds, "default", NOISY_S)
    disturbed = disturbed_batches(bands_m, seeds, "default", STILL_S)
    second = _fly_all([*noisy, *disturbed], lambda share: progress(0.6 + 0.4 * share))
    return Study(
        quiet=_joined(flown_quiet),
        with_drag=_joined(flown_drag),
        still=_joined(flown_still),
        noisy=_joined(second[: len(noisy)]),
        disturbed=_joined(second[len(noisy) :]),
        bands_m=bands_m,
    )


def _joined(batches: Sequence[list[Figures]]) -> list[Figures]:
    return [figures for batch in batches for figures in batch]


def _fly_all(batches: Sequence[Batch], progress: Progress) -> list[list[Figures]]:
    return in_processes(_fly_batch, batches, progress, [batch.work for batch in batches])


def _fly_batch(batch: Batch) -> list[Figures]:
    return fly(batch.cases, batch.duration_s, batch.within_m)
