"""The interaction matrix G of eq. 6 and what its spectrum says: rate, damping, margins (eq. 18 to 22).

The rest of the core decides for one vehicle; this file looks at all of them at once, before anyone flies.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import atan2, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from companion.core.formation import FormationLaw, Gains
from companion.core.priority import next_prc
from companion.core.weights import neighbour_weights

FloatArray = NDArray[np.float64]
Graph = Mapping[int, Collection[int]]  # vehicle id -> ids of its neighbours


def settled_prcs(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """p_i that Algorithm 1 comes to when every vehicle runs it, from p = n (leaders 1)."""
    n = len(graph)
    prcs = {i: 1 if i in leaders else n for i in graph}
    for _ in range(n):
        update = {i: next_prc(i in leaders, (prcs[j] for j in graph[i]), n) for i in graph}
        if update == prcs:
            break
        prcs = update
    return prcs


def interaction_matrix(graph: Graph, leaders: Collection[int], law: FormationLaw) -> FloatArray:
    """G (n x n) of eq. 6 under a law; rows and columns in rising order of the ids.

    u = -K (G e): row i holds the law of vehicle i, with weights from `neighbour_weights` and PrCs from Algorithm 1.
    """
    prcs = settled_prcs(graph, leaders)
    ids = sorted(graph)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    matrix = np.zeros((len(ids), len(ids)))
    for i in ids:
        heeds = i not in leaders or law.leader_heeds_neighbours
        neighbours = sorted(graph[i]) if heeds else []
        weights = neighbour_weights([prcs[j] for j in neighbours], law.exponent)
        for j, weight in zip(neighbours, weights, strict=True):
            matrix[column[i], column[j]] -= weight
        matrix[column[i], column[i]] += sum(weights) + (1.0 if i in leaders else 0.0)
    return matrix


def eigenvalues(matrix: FloatArray) -> FloatArray:
    """Of G, in rising order (n,). They are real (Lemma 2): G is similar to a symmetric matrix."""
    return np.sort(np.linalg.eigvals(matrix).real)


def reached_from(graph: Graph, leaders: Collection[int]) -> set[int]:
    """The vehicles that have a path to a leader; Lemma 1 wants them to be all."""
    reached = set(leaders)
    frontier = list(leaders)
    while frontier:
        new = set(graph[frontier.pop()]) - reached
        reached |= new
        frontier += new
    return reached


@dataclass(frozen=True, slots=True)
class ModeFigures:
    """What one eigenvalue lambda of G means in flight, for lambda^2 + k2 lambda_G s + k1 lambda_G = 0 (eq. 20)."""

    rate_1_s: float  # errors shrink like exp(-rate t)
    damping: float  # 1 is critical
    delay_margin_s: float  # a loop delay beyond this makes the mode unstable


def mode_figures(gains: Gains, eigenvalue: float) -> ModeFigures:
    """Of one mode with lambda > 0, without attitude lag.

    Corollary 1 says that the rate is proportional to lambda; that holds while k2^2 lambda < 4 k1: rate = k2 lambda / 2.
    """
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    damping = k2 * sqrt(eigenvalue) / (2.0 * sqrt(k1))
    discriminant = (k2 * eigenvalue) ** 2 - 4.0 * k1 * eigenvalue
    slowest = k2 * eigenvalue - (sqrt(discriminant) if discriminant > 0.0 else 0.0)
    # The loop lambda (k2 s + k1) / s^2 has gain one at this frequency.
    a = (eigenvalue * k2) ** 2
    crossover_rad_s = sqrt((a + sqrt(a * a + 4.0 * (eigenvalue * k1) ** 2)) / 2.0)
    return ModeFigures(slowest / 2.0, damping, atan2(k2 * crossover_rad_s, k1) / crossover_rad_s)


def lag_margin_s(gains: Gains) -> float:
    """The longest first-order attitude lag that every mode bears: T s^3 + s^2 + k2 lambda s + k1 lambda, Routh: T < k2/k1."""
    return gains.velocity_1_s / gains.position_1_s2


def time_to_shrink_s(rate_1_s: float, error_m: float, within_m: float) -> float:
    """How long an error takes to shrink to `within_m` at this rate. Where G is far from normal it takes longer."""
    return max(0.0, log(error_m / within_m) / rate_1_s) if rate_1_s > 0.0 else inf
