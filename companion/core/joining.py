"""Into a formation that others fly already: from where the vehicle is, beside the fleet, smoothly into its slot.

What it flies is its slot + delta: the quintic that begins with all that its place and velocity differ from the slot's, and dies
out. The law then finds it in its place all along, and pulls neither it nor its neighbours. Who forms together, from a take-off,
begins without: there the law settles what is left.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import dist, hypot

from companion.core.formation import Place, place
from companion.core.hand_over import LONGEST_S, SAMPLES, SHORTEST_S, within
from companion.core.peers import PeerState
from companion.geometry.curves import Curve, duration_s, dying_out
from companion.geometry.turning import unturned
from companion.types import FlightPhase, Heading, PeerPacket, Vector3

JOINS_AFTER_S = 2.0  # from when on others are in formation, and not forming
ACCELERATION_M_S2 = 1.0
LONGER = 1.1

Way = tuple[Curve, float]
"""delta, and how long it lasts."""


class Joining:
    """One vehicle's: who is in formation since when, and the way to the own slot among them."""

    def __init__(self, own_id: int, separation_m: float, speed_m_s: float) -> None:
        self._own_id = own_id
        self._separation_m = separation_m
        self._speed_m_s = speed_m_s
        self._since_s: dict[int, float] = {}

    def hear(self, now_s: float, flying: Iterable[PeerPacket]) -> None:
        """Once a tick: all others that are heard of and fly."""
        in_formation = [p.vehicle_id for p in flying if p.phase is FlightPhase.FORMATION]
        self._since_s = {i: self._since_s.get(i, now_s) for i in in_formation}

    def is_due(self, now_s: float) -> bool:
        """Is there a formation to be joined?"""
        return any(now_s - since_s > JOINS_AFTER_S for since_s in self._since_s.values())

    def way(
        self,
        now_s: float,
        position_enu_m: Vector3,
        velocity_enu_m_s: Vector3,
        slot: Vector3,
        heading: Heading,
        peers: Collection[PeerState],
    ) -> Way:
        """From there to this slot, both in the formation's own frame, which has this heading.

        `peers` are all that fly; some of them are in formation. Raises ValueError: why not.
        """
        formed = [peer for peer in peers if peer.packet.phase is FlightPhase.FORMATION]
        self._look_for_movement(peers)
        fleet = _fleet(now_s, formed)
        for peer in formed:
            apart_m = dist(slot, unturned(peer.slot_at(now_s).position_enu_m, heading))
            if apart_m < self._separation_m:
                raise ValueError(f"its slot is taken: vehicle {peer.packet.vehicle_id} flies {apart_m:.2f} m from it")
        (x, y, z), (vx, vy, vz) = fleet.position_enu_m, fleet.velocity_enu_m_s
        relative = (position_enu_m[0] - x, position_enu_m[1] - y, position_enu_m[2] - z)
        here = unturned(relative, heading)
        error = (here[0] - slot[0], here[1] - slot[1], here[2] - slot[2])
        rate = heading.rate_rad_s  # what stands goes the other way round about a formation that turns
        drift_enu = (
            velocity_enu_m_s[0] - vx + rate * relative[1],
            velocity_enu_m_s[1] - vy - rate * relative[0],
            velocity_enu_m_s[2] - vz,
        )
        drift = unturned(drift_enu, heading)
        delta, lasts_s = self._gentle(error, drift)
        points = [delta(lasts_s * k / SAMPLES)[0] for k in range(SAMPLES + 1)]
        for peer in peers:
            px, py, pz = peer.position_at(now_s)
            dx, dy, dz = unturned((px - x, py - y, pz - z), heading)
            there = (dx - slot[0], dy - slot[1], dz - slot[2])
            apart_m = min(dist(point, there) for point in points)
            if apart_m < self._separation_m:
                raise ValueError(
                    f"its way to its slot comes within {apart_m:.2f} m of vehicle {peer.packet.vehicle_id};"
                    f" expected at least separation_m, {self._separation_m:g} m"
                )
        return delta, lasts_s

    def _look_for_movement(self, peers: Iterable[PeerState]) -> None:
        """One after the other: nothing else may move while a vehicle comes in."""
        for packet in (peer.packet for peer in peers):
            slot = packet.slot
            if packet.phase is FlightPhase.FORMATION and (slot.moves or slot.waiting != slot.formation):
                raise ValueError(f"vehicle {packet.vehicle_id} is still to take up its slot; give form again then")
            if packet.phase is FlightPhase.ENGAGE and packet.vehicle_id < self._own_id:
                raise ValueError(f"vehicle {packet.vehicle_id} joins just now; give form again then")

    def _gentle(self, error_m: Vector3, drift_m_s: Vector3) -> Way:
        """Adds no more than the limits to the speed that there is. Raises ValueError where that takes for ever."""
        speed_m_s = self._speed_m_s + hypot(*drift_m_s)
        lasts_s = max(SHORTEST_S, duration_s(hypot(*error_m), speed_m_s, ACCELERATION_M_S2))
        while lasts_s <= LONGEST_S:
            delta = dying_out((error_m, drift_m_s, (0.0, 0.0, 0.0)), lasts_s)
            times_s = [lasts_s * k / SAMPLES for k in range(SAMPLES + 1)]
            if within(delta, times_s, speed_m_s, ACCELERATION_M_S2):
                return delta, lasts_s
            lasts_s *= LONGER
        raise ValueError(f"it is {hypot(*error_m):.0f} m from its slot, too far to fly there within {LONGEST_S:g} s")


def _fleet(now_s: float, formed: Collection[PeerState]) -> Place:
    """Where those in formation have the RFT, on average. Raises ValueError where there are none."""
    if not formed:
        raise ValueError("nobody is in formation any more")
    places = [place(p.position_at(now_s), p.packet.velocity_enu_m_s, p.slot_at(now_s)) for p in formed]
    return Place(_mean([p.position_enu_m for p in places]), _mean([p.velocity_enu_m_s for p in places]))


def _mean(vectors: Collection[Vector3]) -> Vector3:
    x, y, z = (sum(components) / len(vectors) for components in zip(*vectors, strict=True))
    return (x, y, z)
