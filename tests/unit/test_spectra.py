"""Shapes of any size, and their sparse spectra against the dense ones of the core."""

from itertools import combinations
from math import dist

import numpy as np
import pytest

from sitl.shapes import RANGE_M, SPACING_M, Shape, chain, grid, is_connected, random_geometric, ring

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
def test_a_shape_is_connected_and_roomy(shape: Shape) -> None:
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


def test_a_random_graph_is_all_pairs_within_range_and_the_seeds_own() -> None:
    shape = random_geometric(60, np.random.default_rng(1))
    slots = shape.slots_enu_m
    assert set(shape.edges) == {(a, b) for a, b in combinations(slots, 2) if dist(slots[a], slots[b]) <= RANGE_M}
    assert random_geometric(60, np.random.default_rng(1)) == shape
    assert random_geometric(60, np.random.default_rng(2)) != shape


@pytest.mark.parametrize("build", [chain, ring, lambda n: grid(n, 3), lambda n: grid(3, n)])
def test_no_vehicle_at_all_is_refused(build: object) -> None:
    with pytest.raises(ValueError, match="at least 1"):
        build(0)  # type: ignore[operator]
