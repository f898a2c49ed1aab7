"""Neighbour graphs: of a fleet at given positions, and by name, for a new fleet."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, pairwise
from math import dist
from typing import Literal

from companion.config.fleet import EdgeNeighbours, FormationMember, RangeNeighbours
from companion.config.planned_flight import default_neighbours
from companion.types.values import Vector3

Topology = Literal["chain", "double", "ring", "all", "range"]
TOPOLOGY_WORDS: dict[Topology, str] = {
    "chain": "each vehicle and the nearest one with a lower id",
    "double": "each vehicle and the two nearest with lower ids; connected without any one vehicle",
    "ring": "each vehicle and the next id; the last one and the first",
    "all": "all pairs",
    "range": "all vehicles within a range, as they fly",
}


def neighbour_graph(
    neighbours: EdgeNeighbours | RangeNeighbours, positions_enu_m: Mapping[int, Vector3]
) -> dict[int, list[int]]:
    """Neighbour ids of every vehicle, from the edges or from the distances of these positions."""
    graph: dict[int, list[int]] = {i: [] for i in positions_enu_m}
    for i, j in combinations(sorted(graph), 2):
        if isinstance(neighbours, EdgeNeighbours):
            near = (i, j) in neighbours.edges or (j, i) in neighbours.edges
        else:
            near = dist(positions_enu_m[i], positions_enu_m[j]) <= neighbours.range_m
        if near:
            graph[i].append(j)
            graph[j].append(i)
    return graph


def neighbours_of(topology: Topology, members: tuple[FormationMember, ...]) -> EdgeNeighbours | RangeNeighbours:
    """The neighbours of these vehicles in this graph."""
    if topology == "range":
        return default_neighbours([member.slot_enu_m for member in members])
    return EdgeNeighbours(edges=tuple(_edges(topology, {member.id: member.slot_enu_m for member in members})))


def _edges(topology: Topology, slots: dict[int, tuple[float, float, float]]) -> list[tuple[int, int]]:
    ids = sorted(slots)
    if topology == "all":
        return list(combinations(ids, 2))
    if topology == "ring":
        closing = [(ids[-1], ids[0])] if len(ids) > 2 else []
        return [*pairwise(ids), *closing]
    count = 1 if topology == "chain" else 2
    return [
        (other, vehicle_id)
        for index, vehicle_id in enumerate(ids)
        for other in sorted(sorted(ids[:index], key=lambda i: dist(slots[i], slots[vehicle_id]))[:count])
    ]
