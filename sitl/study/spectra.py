"""Spectra of large formations, up to 10,000 vehicles, with sparse matrices.

`companion/analysis/interaction.py` is the dense and complete version; both agree on small formations.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu

from companion.analysis.interaction import couple, eigenvalues, mode_eigenvalues
from companion.analysis.response import Graph, reached_from, settled_prcs
from companion.laws._neighbour_feedback import NeighbourFeedback

DENSE_UP_TO = 20  # vehicles; the Lanczos method needs more dimensions than that
Sparse = Any  # scipy's sparse arrays have no types


def weight_matrix(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> Sparse:
    """w_ij (n x n), rows and columns in rising order of the ids; the row of a leader without coupling is zero."""
    prcs = settled_prcs(graph, leaders)
    ids = sorted(graph)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for i in ids:
        neighbours = sorted(graph[i])
        shares = law.weights(i in leaders, [prcs[j] for j in neighbours])
        rows += [column[i]] * len(shares)
        columns += [column[j] for j in neighbours if shares]
        values += shares
    return csc_array((values, (rows, columns)), shape=(len(ids), len(ids)))


def interaction_matrix(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> Sparse:
    """G (n x n) of eq. 6."""
    weights = weight_matrix(graph, leaders, law)
    return (diags_array(weights.sum(axis=1) + _leader_diagonal(graph, leaders)) - weights).tocsc()


def symmetric_weights(weights: Sparse) -> Sparse:
    """sqrt(w_ij w_ji): the weights after the similarity transform in the proof of Lemma 2 (see `symmetric_like`).

    Where leaders use no neighbours, G is block triangular: the leaders' block has eigenvalue 1, the followers have their own.
    """
    return weights.multiply(weights.T).sqrt().tocsc()


def lambda_min(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> float:
    """The smallest eigenvalue of G, by shift-invert about zero. Zero where a vehicle has no path to a leader."""
    if len(reached_from(graph, leaders)) < len(graph):
        return 0.0
    if len(graph) <= DENSE_UP_TO:
        return float(eigenvalues(couple(graph, leaders, law).G)[0])
    values = eigsh(
        _symmetric(graph, leaders, law)[0], k=1, sigma=0.0, which="LM", v0=_start(len(graph)), return_eigenvectors=False
    )
    return float(values[0])


def mu_min(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> float:
    """The smallest eigenvalue of M = (I - g W)^-1 G, which sets the rate with feed-forward; lambda_min without it.

    1 / mu is the largest eigenvalue of G^-1 (I - g W), which is real (see `mode_eigenvalues`).
    """
    if law.feedforward == 0.0 or len(reached_from(graph, leaders)) < len(graph):
        return lambda_min(graph, leaders, law)
    if len(graph) <= DENSE_UP_TO:
        return float(mode_eigenvalues(couple(graph, leaders, law))[0])
    symmetric, weights = _symmetric(graph, leaders, law)
    n = len(graph)
    fed = diags_array(1.0 - _leader_diagonal(graph, leaders)) @ weights
    loop = (diags_array(np.ones(n)) - law.feedforward * fed).tocsr()
    factors = splu(symmetric)
    inverse = LinearOperator((n, n), matvec=lambda x: factors.solve(loop @ x), dtype=np.float64)
    values = eigs(inverse, k=1, which="LM", v0=_start(n), return_eigenvectors=False)
    return float(1.0 / values[0].real)


def _symmetric(graph: Graph, leaders: Collection[int], law: NeighbourFeedback) -> tuple[Sparse, Sparse]:
    """The symmetric matrix with G's eigenvalues, and the symmetric weights in it."""
    weights = weight_matrix(graph, leaders, law)
    symmetric = symmetric_weights(weights)
    return (diags_array(weights.sum(axis=1) + _leader_diagonal(graph, leaders)) - symmetric).tocsc(), symmetric


def _leader_diagonal(graph: Graph, leaders: Collection[int]) -> NDArray[np.float64]:
    """w_i^l (n,): 1 for leaders, 0 for followers."""
    return np.array([1.0 if i in leaders else 0.0 for i in sorted(graph)])


def _start(n: int) -> NDArray[np.float64]:
    """A fixed start vector, for reproducible results."""
    return np.ones(n)
