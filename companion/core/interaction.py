"""The interaction matrix G of eq. 6 and what its spectrum says: rate, damping, margins (eq. 18 to 22).

The rest of the core decides for one vehicle; this file looks at all of them at once, before anyone flies.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from math import atan2, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from companion.core.arrays import FloatArray
from companion.core.formation import FormationLaw, Gains
from companion.core.weights import neighbour_weights

Graph = Mapping[int, Collection[int]]  # vehicle id -> ids of its neighbours


def settled_prcs(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """p_i that Algorithm 1 comes to when every vehicle runs it: hops to the nearest leader + 1, and n without a path."""
    return dict.fromkeys(graph, len(graph)) | {i: hops + 1 for i, hops in _hops(graph, leaders).items()}


def reached_from(graph: Graph, leaders: Collection[int]) -> set[int]:
    """The vehicles that have a path to a leader; Lemma 1 wants them to be all."""
    return set(_hops(graph, leaders))


def _hops(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """To the nearest leader, of those that have a path to one."""
    hops = dict.fromkeys(leaders, 0)
    waiting = deque(leaders)
    while waiting:
        i = waiting.popleft()
        for j in graph[i]:
            if j not in hops:
                hops[j] = hops[i] + 1
                waiting.append(j)
    return hops


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """How all vehicles act on each other under one law: u = -K (G e) + g W u, in rising order of the ids.

    What is fed forward comes late, so the u on the right is an earlier one.
    """

    law: FormationLaw
    G: FloatArray  # (n, n), eq. 6
    W: FloatArray  # (n, n), weights w_ij of what followers feed forward; a leader's row is zero
    prcs: NDArray[np.int64]  # (n,), p_i
    leads: NDArray[np.bool_]  # (n,)


def couple(graph: Graph, leaders: Collection[int], law: FormationLaw) -> Coupling:
    """All vehicles of a graph under a law, with weights from `neighbour_weights` and PrCs from Algorithm 1."""
    prcs = settled_prcs(graph, leaders)
    ids = sorted(graph)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    weights = np.zeros((len(ids), len(ids)))
    leads = np.array([i in leaders for i in ids])
    for i in ids:
        heeds = i not in leaders or law.leader_heeds_neighbours
        neighbours = sorted(graph[i]) if heeds else []
        shares = neighbour_weights([prcs[j] for j in neighbours], law.exponent)
        weights[column[i], [column[j] for j in neighbours]] = shares
    return Coupling(
        law=law,
        G=np.diag(weights.sum(axis=1) + leads) - weights,
        W=np.where(leads[:, np.newaxis], 0.0, weights),
        prcs=np.array([prcs[i] for i in ids], dtype=np.int64),
        leads=leads,
    )


def interaction_matrix(graph: Graph, leaders: Collection[int], law: FormationLaw) -> FloatArray:
    """G (n x n) of eq. 6 under a law; rows and columns in rising order of the ids."""
    return couple(graph, leaders, law).G


def symmetric_like(matrix: FloatArray) -> FloatArray:
    """A symmetric matrix with the eigenvalues of G, for neighbours that hear each other.

    Lemma 2: with P = diag(p^-alpha) and S = diag(sum_j p_j^-alpha) the weights S^-1 A P of a graph with adjacency A turn
    symmetric under the similarity (P S)^(1/2), and w_ij becomes sqrt(w_ij w_ji). Where a leader heeds nobody that is zero
    and G falls into blocks, whose eigenvalues are G's.
    """
    off_diagonal = matrix - np.diag(np.diag(matrix))
    symmetric: FloatArray = np.diag(np.diag(matrix)) - np.sqrt(off_diagonal * off_diagonal.T)
    return symmetric


def eigenvalues(matrix: FloatArray) -> FloatArray:
    """Of G, in rising order (n,). They are real (Lemma 2): G is similar to a symmetric matrix."""
    return np.asarray(np.linalg.eigvalsh(symmetric_like(matrix)), dtype=np.float64)


def mode_eigenvalues(coupling: Coupling) -> FloatArray:
    """Of M = (I - g W)^-1 G, in rising order (n,): without lag and delay e'' = -K (M e). Without feed-forward M is G.

    They are real and positive as G's are. In the symmetric form, with followers F and leaders L, b = W_FL and
    theta = (1 - mu) / (1 - g mu), an eigenvector has b' (theta - W_FF)^-1 b x_L = (2 - mu - W_LL) x_L. Were Im mu > 0,
    then Im theta < 0 because g < 1, and the two sides would differ in the sign of their imaginary part.
    """
    if coupling.law.feedforward == 0.0:
        return eigenvalues(coupling.G)
    symmetric = symmetric_like(coupling.G)
    weights = np.diag(np.diag(symmetric)) - symmetric
    weights[coupling.leads] = 0.0
    loop = np.eye(len(weights)) - coupling.law.feedforward * weights
    return np.sort(np.linalg.eigvals(np.linalg.solve(loop, symmetric)).real)


@dataclass(frozen=True, slots=True)
class ModeFigures:
    """What one eigenvalue lambda of G (or mu of M) means in flight, for s^2 + k2 lambda s + k1 lambda = 0 (eq. 20)."""

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
    if error_m <= within_m:
        return 0.0
    return log(error_m / within_m) / rate_1_s if rate_1_s > 0.0 else inf
