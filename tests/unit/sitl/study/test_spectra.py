"""Shapes of any size, and their sparse spectra against the dense ones of companion.analysis."""

from itertools import combinations
from math import dist

import numpy as np
import pytest

from companion.analysis.interaction import couple, eigenvalues, mode_eigenvalues
from companion.types.formation import PAPER_GAINS
from sitl.study import spectra
from sitl.study.shapes import RANGE_M, SPACING_M, Shape, chain, grid, is_connected, random_geometric, ring
from tests.helpers.laws import average_22, average_26, cooperative, law_of, weighted

SHAPES = [
    chain(1),
    chain(7),
    ring(1),
    ring(2),
    ring(4),
    ring(9),
    grid(1, 1),
    grid(3, 5),
    random_geometric(1, np.random.default_rng(0)),
    random_geometric(60, np.random.default_rng(1)),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_a_shape_is_connected_and_keeps_its_spacing(shape: Shape) -> None:
    assert list(shape.slots_enu_m) == list(range(1, len(shape.slots_enu_m) + 1))
    assert shape.slots_enu_m[1] == (0.0, 0.0, 0.0)
    assert is_connected(shape.adjacency())
    assert len(set(shape.edges)) == len(shape.edges)
    assert all(a < b for a, b in shape.edges)
    for a, b in combinations(shape.slots_enu_m.values(), 2):
        assert dist(a, b) >= SPACING_M - 1e-9


@pytest.mark.parametrize("shape", [chain(7), ring(2), ring(9), grid(3, 5)], ids=lambda shape: shape.name)
def test_neighbours_are_one_spacing_apart(shape: Shape) -> None:
    for a, b in shape.edges:
        assert dist(shape.slots_enu_m[a], shape.slots_enu_m[b]) == pytest.approx(SPACING_M)


def test_edges_of_small_shapes() -> None:
    assert chain(4).edges == ((1, 2), (2, 3), (3, 4))
    assert ring(4).adjacency() == {1: [2, 4], 2: [1, 3], 3: [2, 4], 4: [1, 3]}
    assert grid(2, 2).edges == ((1, 2), (1, 3), (2, 4), (3, 4))


def test_a_random_graph_has_all_pairs_within_range_and_depends_on_the_seed() -> None:
    shape = random_geometric(60, np.random.default_rng(1))
    slots = shape.slots_enu_m
    assert set(shape.edges) == {(a, b) for a, b in combinations(slots, 2) if dist(slots[a], slots[b]) <= RANGE_M}
    assert random_geometric(60, np.random.default_rng(1)) == shape
    assert random_geometric(60, np.random.default_rng(2)) != shape


@pytest.mark.parametrize("build", [chain, ring, lambda n: grid(n, 3), lambda n: grid(3, n)])
def test_a_shape_without_vehicles_is_refused(build: object) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        build(0)  # type: ignore[operator]


LAWS = [
    weighted(),
    average_22(),
    average_26(),
    cooperative(),
    law_of(PAPER_GAINS, 3.0, False, 0.5),
]


@pytest.mark.parametrize(
    "shape", [chain(1), chain(2), chain(60), ring(30), grid(5, 9), SHAPES[-1]], ids=lambda shape: shape.name
)
@pytest.mark.parametrize("leaders", [{1}, {1, 2}], ids=str)
def test_sparse_spectra_equal_the_dense_ones(shape: Shape, leaders: set[int]) -> None:
    graph = shape.adjacency()
    for law in LAWS:
        coupling = couple(graph, leaders & set(graph), law)
        assert spectra.lambda_min(graph, leaders & set(graph), law) == pytest.approx(
            eigenvalues(coupling.G)[0], abs=1e-9
        )
        assert spectra.mu_min(graph, leaders & set(graph), law) == pytest.approx(
            mode_eigenvalues(coupling)[0], abs=1e-8
        )
        sparse = spectra.interaction_matrix(graph, leaders & set(graph), law).toarray()
        assert sparse == pytest.approx(coupling.G, abs=1e-12)


def test_lambda_min_of_a_chain_of_10_000_equals_its_formula() -> None:
    """Eq. 26 on a chain: 1 - cos(pi / (2 (n - 1))), the followers between a fixed end and a free one."""
    n = 10_000
    assert spectra.lambda_min(chain(n).adjacency(), {1}, average_26()) == pytest.approx(
        1.0 - np.cos(np.pi / (2 * (n - 1))), rel=1e-6
    )


def test_lambda_min_of_a_random_graph_of_10_000() -> None:
    graph = random_geometric(10_000, np.random.default_rng(1)).adjacency()
    paper, average = (spectra.lambda_min(graph, {1}, law) for law in (weighted(), average_22()))
    assert 0.0 < average < paper < spectra.lambda_min(graph, {1}, cooperative())


def test_lambda_min_is_zero_without_a_path_to_a_leader() -> None:
    assert spectra.lambda_min({1: [2], 2: [1], 3: []}, {1}, weighted()) == 0.0
    assert spectra.mu_min({1: []}, set(), cooperative()) == 0.0
