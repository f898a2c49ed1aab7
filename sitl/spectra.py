"""Spectra of large formations, up to 10,000 vehicles, with sparse matrices. `companion/core/interaction.py` is the dense
and complete one; both agree on small formations.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, diags_array
from scipy.sparse.linalg import LinearOperator, eigs, eigsh, splu

from companion.core.formation import FormationLaw
from companion.core.interaction import Graph, couple, eigenvalues, mode_eigenvalues, reached_from, settled_prcs
from companion.core.weights import neighbour_weights

DENSE_UP_TO = 20  # vehicles; below, Lanczos' method has too few dimensions to work in
Sparse = Any  # scipy's sparse arrays carry no types


def weight_matrix(graph: Graph, leaders: Collection[int], law: FormationLaw) -> Sparse:
    """w_ij (n x n), rows and columns in rising order of the ids; a leader's row is zero where it heeds nobody."""
    prcs = settled_prcs(graph, leaders)
    ids = sorted(graph)
    column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
    rows: list[int] = []
    columns: list[int] = []
    values: list[float] = []
    for i in ids:
        neighbours = sorted(graph[i]) if i not in leaders or law.leader_heeds_neighbours else []
        rows += [column[i]] * len(neighbours)
        columns += [column[j] for j in neighbours]
        values += neighbour_weights([prcs[j] for j in neighbours], law.exponent)
    return csc_array((values, (rows, columns)), shape=(len(ids), len(ids)))


def interaction_matrix(graph: Graph, leaders: Collection[int], law: FormationLaw) -> Sparse:
    """G (n x n) of eq. 6."""
    weights = weight_matrix(graph, leaders, law)
    return (diags_array(weights.sum(axis=1) + _leads(graph, leaders)) - weights).tocsc()


def symmetric_weights(weights: Sparse) -> Sparse:
    """sqrt(w_ij w_ji), what the weights turn into under the similarity of Lemma 2's proof (see `symmetric_like` of the core).

    Where a leader heeds nobody G falls into blocks: the leaders' ones, whose eigenvalue is 1, and the followers' own.
    """
    return weights.multiply(weights.T).sqrt().tocsc()


def lambda_min(graph: Graph, leaders: Collection[int], law: FormationLaw) -> float:
    """The smallest eigenvalue of G, by shift and invert about zero. Zero where no path leads from a leader to a vehicle."""
    if len(reached_from(graph, leaders)) < len(graph):
        return 0.0
    if len(graph) <= DENSE_UP_TO:
        return float(eigenvalues(couple(graph, leaders, law).G)[0])
    values = eigsh(
        _symmetric(graph, leaders, law)[0], k=1, sigma=0.0, which="LM", v0=_start(len(graph)), return_eigenvectors=False
    )
    return float(values[0])


def mu_min(graph: Graph, leaders: Collection[int], law: FormationLaw) -> float:
    """The smallest eigenvalue of M = (I - g W)^-1 G, which sets the rate with feed-forward; without it lambda_min.

    1 / mu is the largest eigenvalue of G^-1 (I - g W); real as `mode_eigenvalues` of the core shows.
    """
    if law.feedforward == 0.0 or len(reached_from(graph, leaders)) < len(graph):
        return lambda_min(graph, leaders, law)
    if len(graph) <= DENSE_UP_TO:
        return float(mode_eigenvalues(couple(graph, leaders, law))[0])
    symmetric, weights = _symmetric(graph, leaders, law)
    n = len(graph)
    fed = diags_array(1.0 - _leads(graph, leaders)) @ weights
    loop = (diags_array(np.ones(n)) - law.feedforward * fed).tocsr()
    factors = splu(symmetric)
    inverse = LinearOperator((n, n), matvec=lambda x: factors.solve(loop @ x), dtype=np.float64)
    values = eigs(inverse, k=1, which="LM", v0=_start(n), return_eigenvectors=False)
    return float(1.0 / values[0].real)


def _symmetric(graph: Graph, leaders: Collection[int], law: FormationLaw) -> tuple[Sparse, Sparse]:
    """The symmetric matrix with G's eigenvalues, and the symmetric weights in it."""
    weights = weight_matrix(graph, leaders, law)
    symmetric = symmetric_weights(weights)
    return (diags_array(weights.sum(axis=1) + _leads(graph, leaders)) - symmetric).tocsc(), symmetric


def _leads(graph: Graph, leaders: Collection[int]) -> NDArray[np.float64]:
    return np.array([1.0 if i in leaders else 0.0 for i in sorted(graph)])


def _start(n: int) -> NDArray[np.float64]:
    """The same first vector every time, so that the figures are, too."""
    return np.ones(n)
