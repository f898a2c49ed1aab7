"""The flights of the study: shapes, settings, durations, noise, drag and links."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sitl.study.cases import BAD_LINKS, GOOD_LINKS, Case, Sensing
from sitl.study.settings import COOPERATIVE, MAIN, SETTINGS, Setting
from sitl.study.shapes import Shape, chain, chain_led_at_both_ends, grid, random_geometric, ring
from sitl.vehicle.config import Airframe, Links

SHAPES_SEED = 1
GOAL_SHAPES = (chain(16), grid(10, 10))
LARGE = 50  # vehicles; from here on a batch holds fewer formations


@dataclass(frozen=True, slots=True)
class Batch:
    """Cases of one shape that fly in one batch."""

    cases: tuple[Case, ...]
    duration_s: float

    @property
    def work(self) -> float:
        """Estimate of the run time, to start the longest batch first and for the progress line."""
        n = len(self.cases[0].shape.slots_enu_m)
        return self.duration_s * (20.0 + len(self.cases) * n * (1.0 + n / 20.0))


def shapes(full: bool) -> list[Shape]:
    """All shapes. SHAPES_SEED determines the random ones."""
    generator = np.random.default_rng(SHAPES_SEED)
    found = [chain(4), chain(16), ring(16), grid(4, 4), random_geometric(16, generator), grid(10, 10)]
    if full:
        found += [
            chain(8),
            chain(32),
            chain(64),
            ring(64),
            random_geometric(50, generator),
            random_geometric(100, generator),
        ]
    return found


def compared_shapes() -> list[Shape]:
    """Those in which the candidates for `cooperative` are compared, deep ones above all."""
    return [
        chain(16),
        chain(100),
        chain_led_at_both_ends(100),
        ring(64),
        grid(10, 10),
        random_geometric(100, np.random.default_rng(SHAPES_SEED)),
    ]


def quiet_batches(full: bool, duration_s: float) -> list[Batch]:
    """Every shape with every setting, without noise: attitude lag and ideal links."""
    return [
        batch for shape in shapes(full) for batch in _split([Case(shape, setting) for setting in SETTINGS], duration_s)
    ]


def long_batches(duration_s: float) -> list[Batch]:
    """The shapes of the goals with the main laws, long enough for the slow ones to settle."""
    return [Batch(tuple(Case(shape, setting) for setting in MAIN), duration_s) for shape in GOAL_SHAPES]


def drag_batches(duration_s: float) -> list[Batch]:
    """The shapes of the goals with the main laws and the drag of the default airframe, which adds damping."""
    drag = Airframe().drag_n_per_m_s
    return [
        Batch(tuple(Case(shape, setting, drag_n_per_m_s=drag) for setting in MAIN), duration_s) for shape in GOAL_SHAPES
    ]


def noisy_batches(seeds: int, sensors: Sensing, duration_s: float) -> list[Batch]:
    """The shapes of the goals with the main laws and noise, to be flown in pairs."""
    return [
        batch
        for shape in GOAL_SHAPES
        for setting in MAIN
        for batch in _pairs(_cases(shape, setting, sensors, GOOD_LINKS, seeds), duration_s)
    ]


def disturbed_batches(seeds: int, sensors: Sensing, duration_s: float) -> list[Batch]:
    """The same under `cooperative`, with packet loss and delay."""
    return [
        batch
        for shape in GOAL_SHAPES
        for batch in _pairs(_cases(shape, COOPERATIVE, sensors, BAD_LINKS, seeds), duration_s)
    ]


def _cases(shape: Shape, setting: Setting, sensors: Sensing, links: Links, seeds: int) -> list[Case]:
    return [Case(shape, setting, sensors, links, seed) for seed in _seeds(shape, seeds)]


def _seeds(shape: Shape, seeds: int) -> range:
    """Seeds from 1; half as many for large shapes, which have many vehicles with noise of their own."""
    return range(1, (max(1, seeds // 2) if _is_large(shape) else seeds) + 1)


def _split(cases: list[Case], duration_s: float) -> list[Batch]:
    return _in_batches_of(10 if _is_large(cases[0].shape) else 30, cases, duration_s)


def _pairs(cases: list[Case], duration_s: float) -> list[Batch]:
    """Smaller batches: each case flies twice, and for longer."""
    return _in_batches_of(4 if _is_large(cases[0].shape) else 8, cases, duration_s)


def _in_batches_of(most: int, cases: list[Case], duration_s: float) -> list[Batch]:
    return [Batch(tuple(cases[k : k + most]), duration_s) for k in range(0, len(cases), most)]


def _is_large(shape: Shape) -> bool:
    return len(shape.slots_enu_m) >= LARGE
