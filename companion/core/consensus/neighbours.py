"""The neighbour set N_i: by explicit edges, or by range with hysteresis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist
from typing import Protocol

from companion.core.consensus.peers import PeerState
from companion.types.vectors import Vector3


class NeighbourRule(Protocol):
    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:
        """Ids of `peers` that are neighbours, in ascending order."""


class EdgeRule:
    """Neighbours by configured edges: the other ends of this vehicle's edges, while their packets are fresh."""

    def __init__(self, own_id: int, edges: Iterable[tuple[int, int]]) -> None:
        self._others = sorted({b if a == own_id else a for a, b in edges if own_id in (a, b)})

    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:  # noqa: ARG002
        return tuple([i for i in self._others if i in peers])


class RangeRule:
    """Neighbours by range: added within `range_m`, removed beyond `range_m + hysteresis_m`."""

    def __init__(self, range_m: float, hysteresis_m: float) -> None:
        self._join_m = range_m
        self._leave_m = range_m + hysteresis_m
        self._members: frozenset[int] = frozenset()

    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:
        self._members = frozenset(
            i
            for i, peer in peers.items()
            if dist(own_position_enu_m, peer.position_at(now_s))
            <= (self._leave_m if i in self._members else self._join_m)
        )
        return tuple(sorted(self._members))
