"""The neighbour sets of a flight over time: lost edges, smallest lambda_min, paths to the leader."""

from __future__ import annotations

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from companion.analysis.interaction import eigenvalues, interaction_matrix
from companion.analysis.response import reached_from
from companion.laws._neighbour_feedback import NeighbourFeedback
from sitl.study.shapes import LEADER

BoolArray = NDArray[np.bool_]
Graph = dict[int, list[int]]


class Topology(Struct, frozen=True, kw_only=True):
    """The topology of one flight.

    `lambda_min`: the smallest over time while all vehicles had a path to the leader, None where they never had. `edges_lost`:
    number of losses of mutual neighbours. `cut_off_s`: first time at which a vehicle had no path to the leader, or None.
    `would_hand_over`: number of vehicles without a leader beacon for so long that their agents would have handed over to the
    autopilot's hold; in this simulation they fly on.
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
    """lambda_min of topologies, computed once for each distinct topology."""

    def __init__(self, law: NeighbourFeedback, vehicles: int) -> None:
        self._law = law
        self._ids = range(1, vehicles + 1)
        self._known: dict[bytes, float | None] = {}

    def lambda_min(self, edges: BoolArray) -> float | None:
        """lambda_min of one topology (n, n); None where a vehicle has no path to the leader."""
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
    """Edges (..., n, n): pairs that use each other as neighbours."""
    return neighbours & np.swapaxes(neighbours, -1, -2)


def losses(edges: BoolArray) -> int:
    """Number of edge losses over (ticks, n, n)."""
    gone = edges[:-1] & ~edges[1:]
    return int(gone.sum()) // 2


def over_time(edges: BoolArray, spectra: Spectra) -> list[float | None]:
    """lambda_min at every sample of (ticks, n, n)."""
    return [spectra.lambda_min(now) for now in edges]


def without_beacon(uses: BoolArray, sample_s: float, limit_s: float) -> int:
    """Number of vehicles that once receive no leader beacon for longer than `limit_s`.

    `uses` (ticks, n, n): whether i uses j as a neighbour. The beacon passes from neighbour to neighbour within one sample.
    """
    receives = _receives_beacon(uses)
    silent = np.zeros(receives.shape[1], dtype=np.int64)
    longest = silent.copy()
    for now in receives:
        silent = np.where(now, 0, silent + 1)
        np.maximum(longest, silent, out=longest)
    return int(((longest - 1) * sample_s > limit_s - 1e-9).sum())


def _receives_beacon(uses: BoolArray) -> BoolArray:
    """Whether each vehicle has a path to the leader (ticks, n)."""
    receives = np.zeros(uses.shape[:2], dtype=np.bool_)
    receives[:, LEADER - 1] = True
    for _ in range(uses.shape[1] - 1):
        receives |= (uses & receives[:, None, :]).any(axis=2)
    return receives
