"""The built-in laws in closed form, as `companion.analysis` once computed them: witnesses of what it finds numerically."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from math import atan2, sqrt

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.analysis.response import Graph, settled_prcs
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.formation import Gains


def weight_matrix(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> FloatArray:
    """w_ij (n, n) in rising order of the ids."""
    prcs, ids = settled_prcs(graph, leaders), sorted(graph)
    weights = np.zeros((len(ids), len(ids)))
    for i in ids:
        neighbours = sorted(graph[i])
        shares = law.weights(i in leaders, [prcs[j] for j in neighbours])
        weights[ids.index(i), [ids.index(j) for j in neighbours if shares]] = shares
    return weights


def interaction_matrix(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> FloatArray:
    """G = G^L + I - W of eq. 6."""
    weights = weight_matrix(graph, leaders, law)
    is_leader = np.array([i in leaders for i in sorted(graph)])
    return np.diag(weights.sum(axis=1) + is_leader) - weights


def fed_forward(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> FloatArray:
    """g W, of followers alone."""
    is_leader = np.array([i in leaders for i in sorted(graph)])
    return law.feedforward * np.where(is_leader[:, np.newaxis], 0.0, weight_matrix(graph, leaders, law))


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


def mode_eigenvalues(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> FloatArray:
    """Eigenvalues of M = (I - g W)^-1 G (n,), rising. Without lag and delay e'' = -K (M e).

    Without feed-forward M is G. The eigenvalues are real and positive, as those of G are: in the
    symmetric form, with followers F and leaders L, b = W_FL and theta = (1 - mu) / (1 - g mu), an
    eigenvector satisfies b' (theta - W_FF)^-1 b x_L = (2 - mu - W_LL) x_L. For Im mu > 0 and g < 1,
    Im theta < 0, and the imaginary parts of the two sides would have different signs.
    """
    symmetric = symmetric_like(interaction_matrix(graph, leaders, law))
    if law.feedforward == 0.0:
        return np.linalg.eigvalsh(symmetric)
    weights = np.diag(np.diag(symmetric)) - symmetric
    weights[[i in leaders for i in sorted(graph)]] = 0.0
    loop = np.eye(len(weights)) - law.feedforward * weights
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
