"""Roles, neighbours and PrCs as reported by the vehicles, and the interaction matrix G computed from them alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from companion.assembly import law_of
from companion.core.consensus.law import neighbour_weights
from companion.stability.arrays import FloatArray
from companion.types.flight import Role
from sitl.paper.flights import FlownPlan
from sitl.report.records import TopologyChange


@dataclass(frozen=True, slots=True)
class VehicleReport:
    """Role, PrC and neighbours reported by one vehicle."""

    role: Role
    prc: int
    neighbours: tuple[int, ...]


Topology = dict[int, VehicleReport]  # by vehicle id


@dataclass(frozen=True, slots=True)
class LeadershipSpan:
    """UAV `leader_id` was leader from `from_s` to `to_s` of the flight's clock. `settled_s`: time of the last PrC change."""

    leader_id: int
    from_s: float
    settled_s: float
    to_s: float


def topology_at(changes: Sequence[TopologyChange], time_s: float) -> Topology:
    """The last report of each vehicle at this time."""
    found: Topology = {}
    for change in changes:
        if change.time_s <= time_s:
            found[change.vehicle] = VehicleReport(change.role, change.prc, change.neighbours)
    return dict(sorted(found.items()))


def leaderships(flown: FlownPlan) -> list[LeadershipSpan]:
    """All leaderships of the formation, in order of time. Raises NoFormationError."""
    formation = flown.flight().formation
    first = topology_at(flown.topology, formation.start_s)
    starts = [(next(i for i, report in first.items() if report.role is Role.LEADER), formation.start_s)]
    for change in flown.topology:
        in_formation = formation.start_s < change.time_s < formation.end_s
        if in_formation and change.role is Role.LEADER and change.vehicle != starts[-1][0]:
            starts.append((change.vehicle, change.time_s))
    ends = [*(from_s for _, from_s in starts[1:]), formation.end_s]
    return [
        LeadershipSpan(leader_id, from_s, _settled_s(flown.topology, from_s, to_s), to_s)
        for (leader_id, from_s), to_s in zip(starts, ends, strict=True)
    ]


def _settled_s(changes: Sequence[TopologyChange], from_s: float, to_s: float) -> float:
    """Time of the last change of the topology in this leadership."""
    return max([from_s, *(change.time_s for change in changes if from_s <= change.time_s < to_s)])


def reported_matrix(flown: FlownPlan, topology: Topology) -> FloatArray:
    """G by Algorithm 2 from the reported PrCs and neighbours."""
    law, ids = law_of(flown.scenario.fleet.law), sorted(topology)
    matrix = np.zeros((len(ids), len(ids)))
    for row, i in enumerate(ids):
        report = topology[i]
        is_leader = report.role is Role.LEADER
        neighbours = report.neighbours if not is_leader or law.leader_uses_neighbours else ()
        weights = neighbour_weights([topology[j].prc for j in neighbours], law.weighting)
        for j, weight in zip(neighbours, weights, strict=True):
            matrix[row, ids.index(j)] = -weight
        matrix[row, row] = sum(weights) + is_leader
    return matrix
