"""The neighbour set N_i, by explicit edges or by range with hysteresis; and the distant peers of a large fleet.

Distant peers are those that this vehicle receives at 5 Hz instead of 50 Hz. A peer may become distant only in steady flight:
both are in formation, in slots at rest, and the leader is heard. It is farther away than any two vehicles can come together
before this vehicle would have it at 50 Hz again. Whatever is not known to be so is received at 50 Hz: forming, leaving,
landing, a change of the formation, a lost leader, a silent vehicle.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from math import dist, inf, sqrt
from typing import Protocol

from companion.core.consensus.peers import DISTANT_MAX_AGE_S, PeerState
from companion.geometry.formations import HEIGHT_WEIGHT
from companion.types.autopilot import VehicleState
from companion.types.flight import Flight, FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.values import Vector3


class NeighbourRule(Protocol):
    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:
        """Ids of `peers` that are neighbours, in ascending order."""


class EdgeRule:
    """Neighbours by configured edges: the other ends of this vehicle's edges, while their packets are fresh."""

    def __init__(self, own_id: int, edges: Iterable[tuple[int, int]]) -> None:
        self._others = sorted({b if a == own_id else a for a, b in edges if own_id in (a, b)})

    def select(self, own_position_enu_m: Vector3, peers: Mapping[int, PeerState], now_s: float) -> tuple[int, ...]:  # noqa: ARG002
        return tuple(filter(peers.__contains__, self._others))


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
        if any(peers[i].packet.leader.beacon is not None for i in self._members):
            self._led_s = now_s
        elif self._bridge is None and now_s - self._led_s > BRIDGES_AFTER_S:
            led = [i for i, peer in peers.items() if peer.packet.leader.beacon is not None]
            if led:
                self._bridge = min(led, key=lambda i: (dist(own_position_enu_m, peers[i].position_at(now_s)), i))
                self._bridged_s = now_s
        return tuple(sorted(self._members if self._bridge is None else self._members | {self._bridge}))


FORMATION = FlightPhase.FORMATION  # member lookup of an enum is slow
LOW_RATE_TICKS = 10  # 5 Hz
CHOICE_PERIOD_S = 0.2
STATE_AGE_S = 0.2 + 0.2  # age of the newest packet at 5 Hz when one packet was lost
# From the state used for the choice to full rate: that age, the next choice, the subscription, the first packet at 50 Hz
UNTIL_FULL_RATE_S = STATE_AGE_S + CHOICE_PERIOD_S + 0.1 + 0.1
ROOM_M = 2.0  # covers attitude lag, delays and the response of the separation filter
STEADY_S = 2.0  # so long a peer is steady and far away before it is distant
FARTHER = 1.2  # than needed it is then

NONE: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class DistantLimits:
    """`full_rate_ids`: always received at 50 Hz. `range_m`: with hysteresis, 0 where neighbours are fixed."""

    full_rate_ids: Collection[int]
    range_m: float
    separation_m: float
    acceleration_m_s2: float  # at the tilt limit


class DistantPeers:
    """Chooses the distant peers, CHOICE_PERIOD_S apart."""

    def __init__(self, limits: DistantLimits) -> None:
        self._limits = limits
        self._ids = NONE
        self._since_s: dict[int, float] = {}  # since when each peer has been steady and far away
        self._steady_s = inf  # since when this vehicle has been steady
        self._next_s = -inf

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        slot: FlownSlot,
        hears_leader: bool,
        neighbour_ids: Collection[int],
        peers: Mapping[int, PeerState],
    ) -> frozenset[int]:
        """Ids of the distant ones of these peers. `slot` is the one that this vehicle flies."""
        if flight.phase is not FORMATION or not hears_leader or _changes(slot):
            self._ids, self._steady_s = NONE, inf
            self._since_s.clear()
        elif now_s >= self._next_s:
            self._steady_s = min(self._steady_s, now_s)
            self._next_s = now_s + CHOICE_PERIOD_S
            self._ids = frozenset(self._chosen(now_s, vehicle, slot, neighbour_ids, peers))
        return self._ids

    def _chosen(
        self,
        now_s: float,
        vehicle: VehicleState,
        slot: FlownSlot,
        neighbour_ids: Collection[int],
        peers: Mapping[int, PeerState],
    ) -> Iterable[int]:
        at_full_rate = {*self._limits.full_rate_ids, *neighbour_ids}
        since_s, self._since_s = self._since_s, {}
        for peer_id, peer in peers.items():
            if peer_id in at_full_rate or not _is_steady(now_s, peer, slot):
                continue
            farther = 1.0 if peer_id in self._ids else FARTHER
            if _apart_m(now_s, vehicle, peer) <= farther * self._needed_m(now_s, vehicle, peer):
                continue
            self._since_s[peer_id] = since_s.get(peer_id, now_s)
            if now_s - max(self._since_s[peer_id], self._steady_s) >= STEADY_S:
                yield peer_id

    def _needed_m(self, now_s: float, vehicle: VehicleState, peer: PeerState) -> float:
        """Nearer than this a peer is received at 50 Hz.

        Both may fly towards each other at the tilt limit until it is, and then brake as the separation filter plans to. Where
        more packets are lost than one, they have flown so for longer.
        """
        limits, until_s = self._limits, UNTIL_FULL_RATE_S + max(0.0, now_s - peer.measured_s - STATE_AGE_S)
        towards_m_s2 = 2.0 * limits.acceleration_m_s2
        speed_m_s = dist(vehicle.velocity_enu_m_s, peer.packet.motion.velocity_enu_m_s)
        nearer_m = speed_m_s * until_s + 0.5 * towards_m_s2 * until_s * until_s
        fastest_m_s = speed_m_s + towards_m_s2 * until_s
        braking_m = fastest_m_s * fastest_m_s / towards_m_s2  # each brakes with half of the tilt limit
        # Position errors count as much as separation_m at most.
        apart_m = 2.0 * limits.separation_m + ROOM_M + nearer_m + braking_m
        return max(apart_m, limits.range_m + nearer_m) if limits.range_m else apart_m


def _changes(slot: FlownSlot) -> bool:
    return slot.moves_for_s > 0.0 or slot.waiting != slot.formation


def _is_steady(now_s: float, peer: PeerState, slot: FlownSlot) -> bool:
    """Whether a peer flies in its slot at rest, in the same formation as this vehicle, and does not lead."""
    packet = peer.packet
    return (
        packet.phase is FORMATION
        and packet.role is not Role.LEADER
        and packet.rft is None
        and not _changes(packet.slot)
        and packet.slot.formation == slot.formation
        and now_s - peer.measured_s <= DISTANT_MAX_AGE_S
    )


def _apart_m(now_s: float, vehicle: VehicleState, peer: PeerState) -> float:
    """As the separation filter counts it: a height counts for less, because of the downwash."""
    (x, y, z), (px, py, pz) = vehicle.position_enu_m, peer.position_at(now_s)
    dx, dy, dz = x - px, y - py, (z - pz) * HEIGHT_WEIGHT
    return sqrt(dx * dx + dy * dy + dz * dz)
