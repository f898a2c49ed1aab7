"""What a vehicle flies while the network is split: it brakes straight and stays, as the others expect of it.

Of two vehicles that do not hear each other each keeps off all that the other one may fly. An evasion is not among that: where
both evade, neither is where the other one believes it to be. One silent vehicle has lost its agent or its radio, and the
others hear each other: they evade. Where several fall silent at once, agents live on both sides of a split network. All brake
at once then, on a straight line, and wait; that needs less room than any evasion. A formation flies on where no vehicle has to
evade: its slots rest, all are placed as their slots, and the silent ones so far away that no more distance is kept from them.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist, hypot, inf

from companion.core.consensus.law import feedback
from companion.core.consensus.peers import PeerState
from companion.core.filter.motion import Ahead, Motion, braking
from companion.geometry.vectors import minus
from companion.types.autopilot import VehicleState
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, Gains
from companion.types.values import ZERO3, Vector3

FORMATION = FlightPhase.FORMATION
SEVERAL = 2  # silent vehicles at once
AT_ONCE_S = 1.0  # between the last packets of vehicles that fall silent at once
PLACED_WITHIN_M = 0.5  # of the offset of their slots
NEAR_M = 12.0  # of the last position; farther away a vehicle matters to no evasion
# Of separation_m, more, and the way of so long: the most that the filter keeps from a silent vehicle.
WIDE_RATIO, WIDE_M, WIDE_S = 1.5, 0.2, 0.4
WAITS_S = 30.0  # the longest wait, from the last packet on


class Split:
    """Finds that the network is split near this vehicle, and brakes it straight until it is whole again."""

    def __init__(self, silent_s: float, separation_m: float, braking_m_s2: float, gains: Gains) -> None:
        self._silent_s = silent_s
        self._separation_m = separation_m
        self._braking_m_s2 = braking_m_s2
        self._gains = gains
        self._ids: frozenset[int] = frozenset()  # the vehicles behind the split
        self._in_shape: frozenset[int] = frozenset()  # those that fell silent while the formation kept its shape
        self._from: Motion = (ZERO3, ZERO3, ZERO3)
        self._since_s = -inf

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        ahead: Ahead,
        slot: FlownSlot | None,
        peers: Mapping[int, PeerState],
        fresh: Mapping[int, PeerState],
    ) -> frozenset[int]:
        """The ids of the vehicles behind a split. `slot` is the own one, None outside formation."""
        ids = self._behind(now_s, vehicle, {i: peer for i, peer in peers.items() if i not in fresh})
        if ids and not self._ids:
            narrow = self._is_narrow(now_s, vehicle, [peers[i] for i in ids])
            if ids <= self._in_shape or not (narrow or _changes_shape(now_s, vehicle, slot, peers.values())):
                self._in_shape = ids
                return frozenset()
            self._since_s = now_s
            self._from = (ahead.position_enu_m, ahead.velocity_enu_m_s, ZERO3)
        self._ids, self._in_shape = ids, frozenset()
        return ids

    def _behind(self, now_s: float, vehicle: VehicleState, silent: Mapping[int, PeerState]) -> frozenset[int]:
        heard_s = {
            i: peer.measured_s
            for i, peer in silent.items()
            if self._silent_s < now_s - peer.measured_s < WAITS_S
            and peer.packet.phase is FORMATION
            and (i in self._ids or dist(peer.packet.motion.position_enu_m, vehicle.position_enu_m) < NEAR_M)
        }
        if self._ids.isdisjoint(heard_s):
            last_s = max(heard_s.values(), default=-inf)
            heard_s = {i: time_s for i, time_s in heard_s.items() if last_s - time_s < AT_ONCE_S}
            if len(heard_s) < SEVERAL:
                return frozenset()
        return frozenset(heard_s)

    def _is_narrow(self, now_s: float, vehicle: VehicleState, silent: Iterable[PeerState]) -> bool:
        """Whether one of these is nearer than the filter may ask of a silent vehicle."""
        wide_m = WIDE_RATIO * self._separation_m + WIDE_M + WIDE_S * hypot(*vehicle.velocity_enu_m_s)
        return any(dist(peer.position_at(now_s), vehicle.position_enu_m) < wide_m for peer in silent)

    def acceleration(self, now_s: float, ahead: Ahead) -> Vector3:
        """Along the straight line to where it stops, then back to that place; m/s^2 in ENU.

        Of the state that the attitude lag leads to: a vehicle that brakes already would turn back at half a metre a second.
        """
        there, moving, slowing = braking(self._from, now_s - self._since_s, 0.0, self._braking_m_s2)
        (x, y, z), (vx, vy, vz) = ahead.position_enu_m, ahead.velocity_enu_m_s
        (px, py, pz), (wx, wy, wz), (sx, sy, sz) = there, moving, slowing
        ax, ay, az = feedback(self._gains, (x - px, y - py, z - pz), (vx - wx, vy - wy, vz - wz))
        return (ax + sx, ay + sy, az + sz)


def _changes_shape(now_s: float, vehicle: VehicleState, slot: FlownSlot | None, peers: Iterable[PeerState]) -> bool:
    """Whether a slot moves, or waits to, or a vehicle is not placed as its slot about this one."""
    if slot is not None and (slot.moves or slot.waiting != slot.formation):
        return True
    for peer in peers:
        other = peer.packet.slot
        if peer.packet.phase is not FORMATION:
            continue
        if other.moves or other.waiting != other.formation:
            return True
        if slot is not None:
            apart = minus(vehicle.position_enu_m, peer.position_at(now_s))
            if dist(apart, minus(slot.position_enu_m, other.position_enu_m)) > PLACED_WITHIN_M:
                return True
    return False
