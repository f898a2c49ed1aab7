"""Formations of any size as slots and undirected edges.

Vehicle 1 is a leader, in most shapes the only one, with its slot at the origin.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from itertools import pairwise
from math import ceil, cos, dist, floor, pi, sin, sqrt

import numpy as np

from companion.analysis.response import reached_from
from companion.types.values import Vector3

LEADER = 1
SPACING_M = 1.5
RANGE_M = 3.0  # largest distance of neighbours in a random geometric graph
AREA_PER_VEHICLE_M2 = 2.0 * SPACING_M**2  # dense enough for connected graphs, sparse enough to find free positions
DRAWS = 1000

Cell = tuple[int, int]
Point = tuple[float, float]  # x, y [m]


@dataclass(frozen=True, slots=True)
class Shape:
    """Slots d_i0 by vehicle id, each pair of neighbours once, with the smaller id first, and the ids of the leaders."""

    name: str
    slots_enu_m: dict[int, Vector3]
    edges: tuple[tuple[int, int], ...]
    leaders: tuple[int, ...] = (LEADER,)

    def adjacency(self) -> dict[int, list[int]]:
        """Neighbour ids of every vehicle, in rising order."""
        neighbours: dict[int, list[int]] = {i: [] for i in self.slots_enu_m}
        for a, b in self.edges:
            neighbours[a].append(b)
            neighbours[b].append(a)
        return {i: sorted(found) for i, found in neighbours.items()}


def chain(n: int) -> Shape:
    """A line 1-2-...-n along -x."""
    _need(n)
    slots: dict[int, Vector3] = {i: (0.0 - SPACING_M * (i - 1), 0.0, 0.0) for i in range(1, n + 1)}
    return Shape(f"chain-{n}", slots, tuple(pairwise(range(1, n + 1))))


def chain_led_at_both_ends(n: int) -> Shape:
    """A chain with leaders 1 and n: two waves that meet in the middle."""
    one = chain(n)
    return Shape(f"chain-{n}-led-at-both-ends", one.slots_enu_m, one.edges, (LEADER, n))


def ring(n: int) -> Shape:
    """A regular polygon 1-2-...-n-1 with sides of one spacing; a chain for fewer than three vehicles."""
    _need(n)
    if n < 3:
        return Shape(f"ring-{n}", chain(n).slots_enu_m, chain(n).edges)
    radius_m = SPACING_M / (2.0 * sin(pi / n))
    turns = {i: 2.0 * pi * (i - 1) / n for i in range(1, n + 1)}
    slots = {
        i: (round(radius_m * (cos(turn) - 1.0), 9), round(radius_m * sin(turn), 9), 0.0) for i, turn in turns.items()
    }
    return Shape(f"ring-{n}", slots, (*pairwise(range(1, n + 1)), (1, n)))


def star(n: int) -> Shape:
    """The leader in the middle of a circle, and the only neighbour of all others, which are at least one spacing apart."""
    _need(n)
    around = max(n - 1, 1)
    radius_m = SPACING_M * max(1.0, 0.5 / sin(pi / max(around, 2)))
    turns = {i: 2.0 * pi * (i - 2) / around for i in range(2, n + 1)}
    slots = {i: (round(radius_m * cos(turn), 9), round(radius_m * sin(turn), 9), 0.0) for i, turn in turns.items()}
    return Shape(f"star-{n}", {LEADER: (0.0, 0.0, 0.0)} | slots, tuple((LEADER, i) for i in slots))


def grid(n: int) -> Shape:
    """Rows along -x that are about as many as their places, the last one may be shorter; the leader is at a corner."""
    _need(n)
    columns = ceil(sqrt(n))
    slots = {1 + k: (0.0 - SPACING_M * (k // columns), SPACING_M * (k % columns), 0.0) for k in range(n)}
    sideways = [(i, i + 1) for i in slots if i % columns and i < n]
    backwards = [(i, i + columns) for i in slots if i + columns <= n]
    return Shape(f"grid-{n}", slots, tuple(sorted(sideways + backwards)))


def random_geometric(n: int, generator: np.random.Generator) -> Shape:
    """n random positions in a square, at least one spacing apart; vehicles within RANGE_M of each other are neighbours.

    Draws again until the graph is connected. Raises ValueError after DRAWS draws without a connected graph.
    """
    _need(n)
    for _ in range(DRAWS):
        drawn = _draw(n, generator)
        leader_x, leader_y = drawn[0]
        slots = {i: (round(x - leader_x, 3), round(y - leader_y, 3), 0.0) for i, (x, y) in enumerate(drawn, start=1)}
        shape = Shape(f"random-{n}", slots, _within(slots, RANGE_M))
        if is_connected(shape.adjacency()):
            return shape
    raise ValueError(f"no connected graph of {n} vehicles in {DRAWS} draws")


def is_connected(graph: Mapping[int, Collection[int]]) -> bool:
    """Whether every vehicle has a path to every other."""
    return len(reached_from(graph, list(graph)[:1])) == len(graph)


def _draw(n: int, generator: np.random.Generator) -> list[Point]:
    """n positions in whole millimetres; draws again where one is nearer than a spacing to an earlier one."""
    side_m = sqrt(n * AREA_PER_VEHICLE_M2)
    taken: dict[Cell, list[Point]] = {}
    points: list[Point] = []
    while len(points) < n:
        x, y = (round(float(value), 3) for value in generator.uniform(0.0, side_m, 2))
        if all(dist((x, y), other) >= SPACING_M for other in _nearby(taken, (x, y), SPACING_M)):
            points.append((x, y))
            taken.setdefault(_cell((x, y), SPACING_M), []).append((x, y))
    return points


def _within(slots: Mapping[int, Vector3], range_m: float) -> tuple[tuple[int, int], ...]:
    """Every pair at most `range_m` apart. Cells of that size avoid a test of all pairs."""
    cells: dict[Cell, list[Point]] = {}
    ids = {(x, y): i for i, (x, y, _) in slots.items()}
    for point in ids:
        cells.setdefault(_cell(point, range_m), []).append(point)
    return tuple(
        sorted(
            (i, ids[other])
            for point, i in ids.items()
            for other in _nearby(cells, point, range_m)
            if i < ids[other] and dist(point, other) <= range_m
        )
    )


def _cell(point: Point, size_m: float) -> Cell:
    return (floor(point[0] / size_m), floor(point[1] / size_m))


def _nearby(cells: Mapping[Cell, list[Point]], point: Point, size_m: float) -> list[Point]:
    """All points in the point's own cell and the eight around it."""
    column, row = _cell(point, size_m)
    return [found for a in (-1, 0, 1) for b in (-1, 0, 1) for found in cells.get((column + a, row + b), ())]


def _need(count: int) -> None:
    if count < 1:
        raise ValueError(f"{count} vehicles; expected at least 1")
