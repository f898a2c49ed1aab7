"""The neighbour set N_i: by explicit edges, or by range with hysteresis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist, inf
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


# Without a neighbour that has a leader beacon. Beacons end 0.3 s after the leader was last received.
BRIDGES_AFTER_S = 0.2
BRIDGED_S = 10.0  # a vehicle beyond the range remains a neighbour for so long, then it is looked for again


class RangeRule:
    """Neighbours by range: added within `range_m`, removed beyond `range_m + hysteresis_m`.

    Vehicles that pass each other may lose the range to all that lead to the leader, although they receive it. Where no
    neighbour has a leader beacon, the nearest vehicle that has one becomes a neighbour as well.
    """

    def __init__(self, range_m: float, hysteresis_m: float) -> None:
        self._join_m = range_m
        self._leave_m = range_m + hysteresis_m
        self._members: frozenset[int] = frozenset()
        self._bridge: int | None = None  # a neighbour beyond the range
        self._bridged_s = 0.0
        self._led_s = inf  # when a neighbour last had a leader beacon; inf before the first

    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:
        self._members = frozenset(
            i
            for i, peer in peers.items()
            if dist(own_position_enu_m, peer.position_at(now_s))
            <= (self._leave_m if i in self._members else self._join_m)
        )
        if self._bridge is not None and (self._bridge not in peers or now_s - self._bridged_s > BRIDGED_S):
            self._bridge = None
        if any(peers[i].packet.leader_beacon is not None for i in self._members):
            self._led_s = now_s
        elif self._bridge is None and now_s - self._led_s > BRIDGES_AFTER_S:
            led = [i for i, peer in peers.items() if peer.packet.leader_beacon is not None]
            if led:
                self._bridge = min(led, key=lambda i: (dist(own_position_enu_m, peers[i].position_at(now_s)), i))
                self._bridged_s = now_s
        return tuple(sorted(self._members if self._bridge is None else self._members | {self._bridge}))
