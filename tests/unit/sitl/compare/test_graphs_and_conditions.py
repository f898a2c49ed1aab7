"""Graphs and conditions of a comparison: valid scenarios of any size, paths of most hops, and gains along them."""

from itertools import combinations
from math import dist
from pathlib import Path

import numpy as np
import pytest
from msgspec import to_builtins
from msgspec.structs import replace

from sitl.batch.columns import NOT_MODELLED, columns_of
from sitl.compare.conditions import CONDITIONS
from sitl.compare.graphs import GRAPHS
from sitl.compare.hops import gain_per_hop, longest_path
from sitl.compare.shapes import RANGE_M, SPACING_M, Shape, chain, grid, is_connected, random_geometric, ring, star
from sitl.flight.scenario import scenario_from

SHAPES = [
    *(shape(n) for shape in (chain, ring, star, grid) for n in (1, 2, 3, 7, 16)),
    *(random_geometric(n, np.random.default_rng(n)) for n in (1, 5, 60)),
]


@pytest.mark.parametrize("shape", SHAPES, ids=lambda shape: shape.name)
def test_a_shape_is_connected_and_keeps_its_spacing(shape: Shape) -> None:
    assert list(shape.slots_enu_m) == list(range(1, len(shape.slots_enu_m) + 1))
    assert shape.slots_enu_m[1] == (0.0, 0.0, 0.0)
    assert is_connected(shape.adjacency())
    assert len(set(shape.edges)) == len(shape.edges)
    assert all(a < b for a, b in shape.edges)
    for a, b in combinations(shape.slots_enu_m.values(), 2):
        assert dist(a, b) >= SPACING_M - 1e-6


def test_edges_of_small_shapes() -> None:
    assert chain(4).edges == ((1, 2), (2, 3), (3, 4))
    assert ring(4).adjacency() == {1: [2, 4], 2: [1, 3], 3: [2, 4], 4: [1, 3]}
    assert grid(4).edges == ((1, 2), (1, 3), (2, 4), (3, 4))
    assert grid(5).edges == ((1, 2), (1, 4), (2, 3), (2, 5), (4, 5))  # two rows of 3 and 2
    assert star(4).edges == ((1, 2), (1, 3), (1, 4))


def test_a_random_graph_has_all_pairs_within_range_and_depends_on_the_seed() -> None:
    shape = random_geometric(60, np.random.default_rng(1))
    slots = shape.slots_enu_m
    assert set(shape.edges) == {(a, b) for a, b in combinations(slots, 2) if dist(slots[a], slots[b]) <= RANGE_M}
    assert random_geometric(60, np.random.default_rng(1)) == shape
    assert random_geometric(60, np.random.default_rng(2)) != shape


@pytest.mark.parametrize("graph", GRAPHS)
@pytest.mark.parametrize("condition", CONDITIONS)
def test_every_graph_under_every_condition_is_a_valid_scenario(graph: str, condition: str) -> None:
    """Also one that a batch flies, unless the condition says that it does not."""
    one = CONDITIONS[condition]
    scenario = one.of(GRAPHS[graph].scenario(4, 3))
    assert scenario_from(Path("made"), to_builtins(scenario)) == scenario
    assert scenario.stand_in.seed == 3
    if condition != "lying":
        columns_of([scenario])
    assert one.by_agents or condition != "lying"


@pytest.mark.parametrize("graph", GRAPHS)
def test_graphs_of_100_vehicles_are_made(graph: str) -> None:
    assert len(GRAPHS[graph].scenario(100, 2).fleet.vehicles) == 100


def test_a_lying_vehicle_is_nothing_for_a_batch() -> None:
    assert "links.lies" in NOT_MODELLED
    scenario = CONDITIONS["lying"].of(GRAPHS["chain"].scenario(4, 1))
    assert scenario.links.lies[0].vehicle == 2
    with pytest.raises(ValueError, match=r"a batch does not model links\.lies"):
        columns_of([scenario])


def test_external_vision_is_nothing_for_a_batch() -> None:
    scenario = GRAPHS["chain"].scenario(4, 1)
    by_vision = replace(scenario, stand_in=replace(scenario.stand_in, positioning="external_vision"))
    with pytest.raises(ValueError, match=r"a batch does not model stand_in\.positioning"):
        columns_of([by_vision])


def test_random_starts_lead_to_the_slots_of_a_grid_without_detours() -> None:
    scenario = GRAPHS["range"].scenario(9, 4)
    slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    assert sorted(slots.values()) == sorted(grid(9).slots_enu_m.values())
    starts = scenario.starts_enu_m

    def way(own: dict[int, tuple[float, float, float]]) -> float:
        return sum(dist(starts[i], own[i]) ** 2 for i in own)

    swapped = [slots | {i: slots[j], j: slots[i]} for i, j in combinations(sorted(slots)[1:], 2)]
    assert all(way(slots) <= way(other) + 1e-9 for other in swapped)


@pytest.mark.parametrize(
    ("graph", "path"),
    [
        ("chain", [1, 2, 3, 4, 5, 6]),
        ("ring", [1, 2, 3, 4]),
        ("star", [1, 6]),
        ("two_leaders", [6, 5, 4]),
        ("range", [1]),
    ],
)
def test_the_longest_path_begins_at_a_leader(graph: str, path: list[int]) -> None:
    assert longest_path(GRAPHS[graph].scenario(6, 1)) == path


def test_the_gain_is_that_of_deviations_that_grow_by_a_factor() -> None:
    times_s = np.linspace(0.0, 10.0, 201)
    swing = np.exp(-0.3 * times_s) * np.sin(2.0 * times_s)

    def along(factor: float, hops: int, first_m: float = 0.1) -> list[np.ndarray]:
        tracks = [np.zeros((times_s.size, 3))]
        for k in range(hops):
            tracks.append(tracks[-1] + first_m * factor**k * swing[:, None] * np.array([0.6, 0.8, 0.0]))
        return tracks

    assert gain_per_hop(along(1.3, 5)) == pytest.approx(1.3)
    assert gain_per_hop(along(0.5, 3)) == pytest.approx(0.5)
    assert gain_per_hop(along(0.1, 6)) == pytest.approx(0.1), "what is below a millimetre is not counted"
    assert gain_per_hop(along(1.3, 1)) is None
    assert gain_per_hop(along(1.3, 5, first_m=1e-5)) is None
