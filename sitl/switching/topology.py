"""What the neighbour sets of a flight do over time: edges lost, the smallest lambda_min, who has a path to the leader."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.core.formation import FormationLaw
from companion.core.interaction import eigenvalues, interaction_matrix, reached_from
from sitl.shapes import LEADER

BoolArray = NDArray[np.bool_]
Graph = dict[int, list[int]]


class Topology(Struct, frozen=True, kw_only=True):
    """One flight. `lambda_min` is the smallest over time while all had a path to the leader; None where one never had.

    `edges_lost`: how often two vehicles that heeded each other ceased to; `cut_off_s`: when somebody first had no path to the
    leader, None where that never was. `would_hand_over`: how many vehicles heard no leader's word for so long that their agents
    would have handed over to the autopilot's hold; here they fly on.
    """

    law: str
    seed: int
    hysteresis_m: float
    edges_lost: int
    lambda_min: float | None
    cut_off_s: float | None
    connected_at_the_end: bool
    would_hand_over: int
    final_error_m: float
    closest_m: float


class Spectra:
    """lambda_min of every topology that turns up, worked out once: few of them differ."""

    def __init__(self, law: FormationLaw, vehicles: int) -> None:
        self._law = law
        self._ids = range(1, vehicles + 1)
        self._known: dict[bytes, float | None] = {}

    def lambda_min(self, edges: BoolArray) -> float | None:
        """Of one topology (n, n); None where a vehicle has no path to the leader."""
        key = np.packbits(edges).tobytes()
        if key not in self._known:
            self._known[key] = self._computed(edges)
        return self._known[key]

    def _computed(self, edges: BoolArray) -> float | None:
        graph: Graph = {i: [int(j) + 1 for j in np.flatnonzero(edges[i - 1])] for i in self._ids}
        if len(reached_from(graph, {LEADER})) < len(graph):
            return None
        return float(eigenvalues(interaction_matrix(graph, {LEADER}, self._law))[0])


def mutual(neighbours: BoolArray) -> BoolArray:
    """Edges over time (..., n, n): both heed each other."""
    return neighbours & np.swapaxes(neighbours, -1, -2)


def losses(edges: BoolArray) -> int:
    """How often an edge went, over (ticks, n, n)."""
    gone = edges[:-1] & ~edges[1:]
    return int(gone.sum()) // 2


def over_time(edges: BoolArray, spectra: Spectra) -> list[float | None]:
    """lambda_min at every sample of (ticks, n, n)."""
    return [spectra.lambda_min(now) for now in edges]


def without_word(heeds: BoolArray, sample_s: float, longest_s: float) -> int:
    """How many vehicles are without a way to the leader for longer than that at a stretch; (ticks, n, n) says who heeds whom.

    The word goes from the heeded to the heeding, through all of them within a fraction of a sample.
    """
    hears = _hear_the_leader(heeds)
    silent = np.zeros(hears.shape[1], dtype=np.int64)
    longest = silent.copy()
    for now in hears:
        silent = np.where(now, 0, silent + 1)
        np.maximum(longest, silent, out=longest)
    return int(((longest - 1) * sample_s > longest_s - 1e-9).sum())


def _hear_the_leader(heeds: BoolArray) -> BoolArray:
    """(ticks, n)."""
    hears = np.zeros(heeds.shape[:2], dtype=np.bool_)
    hears[:, LEADER - 1] = True
    for _ in range(heeds.shape[1] - 1):
        hears |= (heeds & hears[:, None, :]).any(axis=2)
    return hears
