"""The interaction matrix G (eq. 6) and the figures of its spectrum: rate, damping, margins (eq. 18 to 22).

The flight core computes for one vehicle. This analysis covers the whole fleet, before a flight.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import atan2, inf, log, sqrt

import numpy as np
from numpy.typing import NDArray

from companion.analysis.response import Graph, settled_prcs
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.formation import Gains


@dataclass(frozen=True, slots=True, eq=False)
class Coupling:
    """Coupling of all vehicles under one law: u = -K (G e) + g W u, in rising order of the ids.

    The fed-forward u on the right side is delayed.
    """

    law: NeighbourFeedback
    G: FloatArray  # (n, n), eq. 6
    W: FloatArray  # (n, n), feed-forward weights w_ij of the followers; a leader's row is zero
    prcs: NDArray[np.int64]  # (n,), p_i
    is_leader: NDArray[np.bool_]  # (n,)


def couple(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> Coupling:
    """Coupling of a graph under a law: weights of `neighbour_weights`, PrCs of Algorithm 1."""
    prcs = settled_prcs(graph, leaders)
    ids = sorted(graph)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    weights = np.zeros((len(ids), len(ids)))
    is_leader = np.array([i in leaders for i in ids])
    for i in ids:
        neighbours = sorted(graph[i])
        shares = law.weights(i in leaders, [prcs[j] for j in neighbours])
        weights[column[i], [column[j] for j in neighbours if shares]] = shares
    return Coupling(
        law=law,
        G=np.diag(weights.sum(axis=1) + is_leader) - weights,
        W=np.where(is_leader[:, np.newaxis], 0.0, weights),
        prcs=np.array([prcs[i] for i in ids], dtype=np.int64),
        is_leader=is_leader,
    )


def interaction_matrix(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> FloatArray:
    """G (n x n) of eq. 6 under a law; rows and columns in rising order of the ids."""
    return couple(graph, leaders, law).G


def symmetric_like(matrix: FloatArray) -> FloatArray:
    """A symmetric matrix with the eigenvalues of G, for an undirected graph.

    Lemma 2: with P = diag(p^-alpha) and S = diag(sum_j p_j^-alpha) the similarity (P S)^(1/2) makes
    the weights S^-1 A P of a graph with adjacency A symmetric, and w_ij becomes sqrt(w_ij w_ji).
    For a leader that uses no neighbours this product is zero; G is then block triangular, and the
    blocks have the eigenvalues of G.
    """
    off_diagonal = matrix - np.diag(np.diag(matrix))
    symmetric: FloatArray = np.diag(np.diag(matrix)) - np.sqrt(off_diagonal * off_diagonal.T)
    return symmetric


def eigenvalues(matrix: FloatArray) -> FloatArray:
    """Eigenvalues of G (n,), rising. They are real: G is similar to a symmetric matrix (Lemma 2)."""
    return np.asarray(np.linalg.eigvalsh(symmetric_like(matrix)), dtype=np.float64)


def mode_eigenvalues(coupling: Coupling) -> FloatArray:
    """Eigenvalues of M = (I - g W)^-1 G (n,), rising. Without lag and delay e'' = -K (M e).

    Without feed-forward M is G. The eigenvalues are real and positive, as those of G are: in the
    symmetric form, with followers F and leaders L, b = W_FL and theta = (1 - mu) / (1 - g mu), an
    eigenvector satisfies b' (theta - W_FF)^-1 b x_L = (2 - mu - W_LL) x_L. For Im mu > 0 and g < 1,
    Im theta < 0, and the imaginary parts of the two sides would have different signs.
    """
    if coupling.law.feedforward == 0.0:
        return eigenvalues(coupling.G)
    symmetric = symmetric_like(coupling.G)
    weights = np.diag(np.diag(symmetric)) - symmetric
    weights[coupling.is_leader] = 0.0
    loop = np.eye(len(weights)) - coupling.law.feedforward * weights
    return np.sort(np.linalg.eigvals(np.linalg.solve(loop, symmetric)).real)


@dataclass(frozen=True, slots=True)
class ModeFigures:
    """Figures of one eigenvalue lambda of G (or mu of M): s^2 + k2 lambda s + k1 lambda = 0 (eq. 20)."""

    rate_1_s: float  # errors shrink like exp(-rate t)
    damping: float  # 1 is critical
    delay_margin_s: float  # a loop delay beyond this makes the mode unstable


def mode_figures(gains: Gains, eigenvalue: float) -> ModeFigures:
    """Figures of one mode with lambda > 0, without attitude lag.

    The rate is proportional to lambda (Corollary 1) for k2^2 lambda < 4 k1 only: k2 lambda / 2.
    """
    k1, k2 = gains.position_1_s2, gains.velocity_1_s
    damping = k2 * sqrt(eigenvalue) / (2.0 * sqrt(k1))
    discriminant = (k2 * eigenvalue) ** 2 - 4.0 * k1 * eigenvalue
    slowest = k2 * eigenvalue - (sqrt(discriminant) if discriminant > 0.0 else 0.0)
    # At this frequency the loop lambda (k2 s + k1) / s^2 has gain one.
    a = (eigenvalue * k2) ** 2
    crossover_rad_s = sqrt((a + sqrt(a * a + 4.0 * (eigenvalue * k1) ** 2)) / 2.0)
    return ModeFigures(slowest / 2.0, damping, atan2(k2 * crossover_rad_s, k1) / crossover_rad_s)


def time_to_shrink_s(rate_1_s: float, error_m: float, within_m: float) -> float:
    """Time in which an error decays to `within_m` at this rate, s. Longer if G is far from normal."""
    if error_m <= within_m:
        return 0.0
    return log(error_m / within_m) / rate_1_s if rate_1_s > 0.0 else inf


FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


def shift_m(gains: Gains, velocity_error_m_s: float) -> float:
    """Distance from the slot with a constant velocity error, m."""
    return gains.velocity_1_s / gains.position_1_s2 * velocity_error_m_s


def share_left(rate_rad_s: float, bandwidth_1_s: float) -> float:
    """Share of a velocity error that turns at this rate which the correction leaves; 1 where it is off.

    The law rests where k1 times the position error balances k2 times the velocity error e: k2/k1 of e away. The correction
    (`core/estimation/corrections.py`) leaves of e what its filter lets pass: s (s + 2 w) / (s + w)^2 e. It acts on the
    difference of the autopilot's own position and velocity, and where both agree it is zero: in the linear model of law and
    correction together the poles are those of the law and twice -w, so it makes no formation unstable.
    """
    if bandwidth_1_s == 0.0:
        return 1.0
    s = 1j * rate_rad_s
    return abs(s * (s + 2.0 * bandwidth_1_s)) / abs(s + bandwidth_1_s) ** 2
