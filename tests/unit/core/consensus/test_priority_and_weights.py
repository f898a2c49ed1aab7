"""Algorithms 1 and 2 and the printed interaction matrices, from roles and neighbour sets."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.consensus.law import next_prc
from companion.laws import neighbour_weights

Graph = dict[int, set[int]]


def graph(*edges: tuple[int, int]) -> Graph:
    neighbours: Graph = {}
    for a, b in edges:
        neighbours.setdefault(a, set()).add(b)
        neighbours.setdefault(b, set()).add(a)
    return neighbours


def settled_prcs(neighbours: Graph, leaders: set[int]) -> dict[int, int]:
    """Algorithm 1 run on every vehicle at once, from p = n, until nothing changes."""
    n = len(neighbours)
    prcs = {i: 1 if i in leaders else n for i in neighbours}
    for _ in range(n + 1):
        prcs = {i: next_prc(i in leaders, (prcs[j] for j in neighbours[i]), n) for i in neighbours}
    return prcs


def interaction_matrix(
    neighbours: Graph, leaders: set[int], exponent: float, leader_has_neighbours: bool = True
) -> np.ndarray:
    """G of eq. 6 from next_prc and neighbour_weights."""
    prcs = settled_prcs(neighbours, leaders)
    ids = sorted(neighbours)
    matrix = np.zeros((len(ids), len(ids)))
    for row, i in enumerate(ids):
        used = sorted(neighbours[i]) if leader_has_neighbours or i not in leaders else []
        weights = neighbour_weights(tuple([prcs[j] for j in used]), exponent)
        for j, weight in zip(used, weights, strict=True):
            matrix[row, ids.index(j)] = -weight
        matrix[row, row] = sum(weights) + (i in leaders)
    return matrix


AGGREGATION = graph((1, 2), (1, 3), (2, 3), (2, 4), (3, 4))
RING = graph((1, 2), (2, 3), (3, 4), (4, 1))
CHAIN = graph((1, 2), (2, 3), (3, 4))
FIGURE_2 = graph((1, 2), (1, 3), (2, 3), (3, 5), (3, 6), (2, 4), (5, 7))


def test_equation_27_average() -> None:
    expected = [[1, 0, 0, 0], [-1 / 3, 1, -1 / 3, -1 / 3], [-1 / 3, -1 / 3, 1, -1 / 3], [0, -1 / 2, -1 / 2, 1]]
    assert np.allclose(
        interaction_matrix(AGGREGATION, {1}, 0.0, leader_has_neighbours=False), expected, atol=1e-12, rtol=0
    )


def test_equation_27_weighted() -> None:
    expected = [
        [2, -1 / 2, -1 / 2, 0],
        [-6 / 11, 1, -3 / 11, -2 / 11],
        [-6 / 11, -3 / 11, 1, -2 / 11],
        [0, -1 / 2, -1 / 2, 1],
    ]
    assert np.allclose(interaction_matrix(AGGREGATION, {1}, 1.0), expected, atol=1e-12, rtol=0)


@pytest.mark.parametrize(
    ("leader", "expected"),
    [
        (1, [[2, -1 / 2, 0, -1 / 2], [-3 / 4, 1, -1 / 4, 0], [0, -1 / 2, 1, -1 / 2], [-3 / 4, 0, -1 / 4, 1]]),
        (2, [[1, -3 / 4, 0, -1 / 4], [-1 / 2, 2, -1 / 2, 0], [0, -3 / 4, 1, -1 / 4], [-1 / 2, 0, -1 / 2, 1]]),
    ],
)
def test_interaction_matrices_of_section_5_2(leader: int, expected: list[list[float]]) -> None:
    assert np.allclose(interaction_matrix(RING, {leader}, 1.0), expected, atol=1e-12, rtol=0)


def test_weights_of_vertex_3_in_figure_2() -> None:
    prcs = settled_prcs(FIGURE_2, {1})
    assert prcs[5] - 1 == 2  # the distance of vertices 1 and 5
    weights = neighbour_weights(tuple([prcs[j] for j in (1, 2, 5, 6)]))
    assert weights == pytest.approx([float(Fraction(k, 13)) for k in (6, 3, 2, 2)], abs=1e-12)


@pytest.mark.parametrize(
    ("exponent", "leader_has_neighbours", "smallest"), [(0.0, True, 0.0789), (0.0, False, 0.1340), (1.0, True, 0.1818)]
)
def test_smallest_eigenvalue_of_the_platoon(exponent: float, leader_has_neighbours: bool, smallest: float) -> None:
    eigenvalues = np.linalg.eigvals(interaction_matrix(CHAIN, {1}, exponent, leader_has_neighbours))
    assert min(eigenvalues.real) == pytest.approx(smallest, abs=5e-5)


@given(st.lists(st.integers(1, 250), min_size=1, max_size=20), st.floats(0, 16), st.floats(0.001, 1.0))
def test_weights_add_up_to_one_and_favour_the_smaller_prc(prcs: list[int], exponent: float, ratio: float) -> None:
    weights = neighbour_weights(tuple(prcs), exponent, ratio)
    assert sum(weights) == pytest.approx(1.0)
    order = sorted(range(len(prcs)), key=lambda i: prcs[i])
    assert all(weights[a] >= weights[b] for a, b in pairwise(order))


@pytest.mark.parametrize("prc", [2, 16, 100, 249])
def test_a_ratio_is_as_sharp_at_every_hop(prc: int) -> None:
    before, behind = neighbour_weights((prc - 1, prc + 1), 0.0, 0.1)
    assert behind / before == pytest.approx(0.01)
    flat = neighbour_weights((prc - 1, prc + 1), 8.0)
    assert flat[1] / flat[0] == pytest.approx(((prc - 1) / (prc + 1)) ** 8)  # 0.0002 at 2 hops, 0.9 at 249


def test_a_ratio_of_one_changes_no_bit() -> None:
    for prcs in ((1, 3), (2, 2, 5), (7, 8, 9)):
        shares = [prc**-8.0 for prc in prcs]
        assert neighbour_weights(prcs, 8.0) == tuple(share / sum(shares) for share in shares)


def test_no_weights_without_neighbours() -> None:
    assert neighbour_weights(()) == ()


def test_prc_rises_to_n_without_a_leader() -> None:
    prcs = {1: 2, 2: 2, 3: 3}
    line = graph((1, 2), (2, 3))
    for _ in range(10):
        prcs = {i: next_prc(False, (prcs[j] for j in line[i]), 3) for i in line}
    assert set(prcs.values()) == {3}


@given(st.integers(2, 30), st.data())
def test_prc_is_the_number_of_hops_to_a_leader_plus_one(n: int, data: st.DataObject) -> None:
    line = graph(*((i, i + 1) for i in range(1, n)))
    leaders = data.draw(st.sets(st.integers(1, n), min_size=1))
    expected = {i: min(abs(i - leader) for leader in leaders) + 1 for i in line}
    assert settled_prcs(line, leaders) == expected
