"""Smallest eigenvalues of formations of up to 10,000 vehicles, which are too large for a flight."""

from __future__ import annotations

from collections.abc import Callable
from math import isqrt

import numpy as np

from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.laws.average_22 import Average22
from companion.laws.average_26 import Average26
from companion.laws.cooperative import Cooperative
from companion.laws.weighted import Weighted
from sitl.study.shapes import LEADER, Shape, chain, grid, random_geometric, ring
from sitl.study.spectra import lambda_min, mu_min

SIZES = (4, 16, 64, 256, 1024, 4096, 10_000)
SEED = 1
LAWS: dict[str, NeighbourFeedback] = {
    "average, eq. 22": Average22(),
    "average, eq. 26": Average26(),
    "weighted (the paper)": Weighted(),
    "cooperative": Cooperative(),
}
WITH_FEEDFORWARD = "cooperative, with feed-forward"  # the smallest eigenvalue of (I - g W)^-1 G, which sets the rate

Spectra = dict[str, dict[str, list[tuple[int, float]]]]  # kind of shape -> law -> (vehicles, smallest eigenvalue)


def _square(n: int) -> Shape:
    return grid(isqrt(n), isqrt(n))


def _random(n: int) -> Shape:
    return random_geometric(n, np.random.default_rng(SEED))


KINDS: dict[str, Callable[[int], Shape]] = {"chain": chain, "ring": ring, "square grid": _square, "random": _random}


def large_spectra(progress: Callable[[float], None]) -> Spectra:
    """Smallest eigenvalues for every kind of shape, size and law."""
    found: Spectra = {kind: {label: [] for label in (*LAWS, WITH_FEEDFORWARD)} for kind in KINDS}
    done = 0
    for kind, shape_of in KINDS.items():
        for size in SIZES:
            shape = shape_of(size)
            graph, n = shape.adjacency(), len(shape.slots_enu_m)
            for label, law in LAWS.items():
                found[kind][label].append((n, lambda_min(graph, {LEADER}, law)))
            found[kind][WITH_FEEDFORWARD].append((n, mu_min(graph, {LEADER}, Cooperative())))
            done += 1
            progress(done / (len(KINDS) * len(SIZES)))
    return found
