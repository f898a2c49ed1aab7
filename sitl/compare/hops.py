"""The longest path from a leader, and how much larger deviations become along it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.fleet import EdgeNeighbours
from companion.types.flight import Role
from sitl.flight.scenario import Scenario

LEAST_M = 1e-3
FEWEST_HOPS = 2


def longest_path(scenario: Scenario) -> list[int]:
    """Ids from a leader to the vehicle with the most hops, by the smallest ids; one leader alone where neighbours change."""
    leaders = sorted(member.id for member in scenario.fleet.vehicles if member.role is Role.LEADER)
    neighbours = scenario.fleet.neighbours
    if not isinstance(neighbours, EdgeNeighbours):
        return leaders[:1]
    graph: dict[int, list[int]] = {member.id: [] for member in scenario.fleet.vehicles}
    for a, b in neighbours.edges:
        graph[a].append(b)
        graph[b].append(a)
    before = dict.fromkeys(leaders, 0)
    reached = list(leaders)
    for i in reached:
        for j in sorted(graph[i]):
            if j not in before:
                before[j] = i
                reached.append(j)
    path = [reached[-1]]
    while before[path[-1]]:
        path.append(before[path[-1]])
    return path[::-1]


def gain_per_hop(displacements_m: Sequence[FloatArray]) -> float | None:
    """`displacements_m`: position minus slot (T, 3) of each vehicle along a path, the leader first.

    e_k is the largest difference over time between vehicle k and the one before it. The gain is the factor g of the line of
    least squares through log e_k = a + k log g, up to the first e_k below LEAST_M. None with fewer than two.
    """
    peaks_m = np.array([np.linalg.norm(own - ahead, axis=1).max() for ahead, own in pairwise(displacements_m)])
    small = np.flatnonzero(peaks_m < LEAST_M)
    peaks_m = peaks_m[: small[0]] if small.size else peaks_m
    if len(peaks_m) < FEWEST_HOPS:
        return None
    slope = np.polyfit(np.arange(len(peaks_m)), np.log(peaks_m), 1)[0]
    return float(np.exp(slope))
