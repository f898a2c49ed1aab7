"""Neighbour graphs by name: which slots are joined by edges."""

from __future__ import annotations

from itertools import combinations, pairwise
from math import dist
from typing import Literal

from companion.config.fleet import EdgeNeighbours, FormationMember, RangeNeighbours
from companion.config.planned_flight import default_neighbours

Topology = Literal["chain", "double", "ring", "all", "range"]
TOPOLOGY_WORDS: dict[Topology, str] = {
    "chain": "each vehicle and the nearest one with a lower id",
    "double": "each vehicle and the two nearest with lower ids; connected without any one vehicle",
    "ring": "each vehicle and the next id; the last one and the first",
    "all": "all pairs",
    "range": "all vehicles within a range, as they fly",
}


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
