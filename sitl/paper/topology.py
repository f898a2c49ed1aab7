"""Who led, whom each vehicle heard and with which PrC, as the vehicles themselves reported it; and G from nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from companion.assembly import law_of
from companion.core.arrays import FloatArray
from companion.core.weights import neighbour_weights
from companion.types import Role
from sitl.paper.flights import FlownPlan
from sitl.watch import TopologyChange


@dataclass(frozen=True, slots=True)
class Said:
    """One vehicle's part of a topology."""

    role: Role
    prc: int
    neighbours: tuple[int, ...]


Topology = dict[int, Said]  # by vehicle id


@dataclass(frozen=True, slots=True)
class Lead:
    """From `from_s` to `to_s` of the flight's clock UAV `leader_id` led. `settled_s`: when the last PrC had followed."""

    leader_id: int
    from_s: float
    settled_s: float
    to_s: float


def topology_at(changes: Sequence[TopologyChange], time_s: float) -> Topology:
    """What each vehicle had last said by then."""
    found: Topology = {}
    for change in changes:
        if change.time_s <= time_s:
            found[change.vehicle] = Said(change.role, change.prc, change.neighbours)
    return dict(sorted(found.items()))


def leads(flown: FlownPlan) -> list[Lead]:
    """All leads of the formation, in turn. Raises NoFormationError."""
    formation = flown.flight().formation
    first = topology_at(flown.topology, formation.start_s)
    starts = [(next(i for i, said in first.items() if said.role is Role.LEADER), formation.start_s)]
    for change in flown.topology:
        in_formation = formation.start_s < change.time_s < formation.end_s
        if in_formation and change.role is Role.LEADER and change.vehicle != starts[-1][0]:
            starts.append((change.vehicle, change.time_s))
    ends = [*(from_s for _, from_s in starts[1:]), formation.end_s]
    return [
        Lead(leader_id, from_s, _settled_s(flown.topology, from_s, to_s), to_s)
        for (leader_id, from_s), to_s in zip(starts, ends, strict=True)
    ]


def _settled_s(changes: Sequence[TopologyChange], from_s: float, to_s: float) -> float:
    """The last change before the next lead."""
    return max([from_s, *(change.time_s for change in changes if from_s <= change.time_s < to_s)])


def reported_matrix(flown: FlownPlan, topology: Topology) -> FloatArray:
    """G by Algorithm 2 from the PrCs and neighbours that the vehicles reported."""
    law, ids = law_of(flown.scenario.fleet.law), sorted(topology)
    matrix = np.zeros((len(ids), len(ids)))
    for row, i in enumerate(ids):
        said = topology[i]
        leads_now = said.role is Role.LEADER
        heeded = said.neighbours if not leads_now or law.leader_heeds_neighbours else ()
        weights = neighbour_weights([topology[j].prc for j in heeded], law.exponent)
        for j, weight in zip(heeded, weights, strict=True):
            matrix[row, ids.index(j)] = -weight
        matrix[row, row] = sum(weights) + leads_now
    return matrix


def printed_matrix(rows: Sequence[str]) -> FloatArray:
    """["2 -1/2", "-3/4 1"] -> G."""
    return np.array([[float(Fraction(entry)) for entry in row.split()] for row in rows])
