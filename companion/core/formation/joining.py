"""Joining: the path from a vehicle's position into its slot of a formation that others fly already.

Vehicles join one at a time, on a path of `paths.py`. Vehicles that form together do so by `entry.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import dist

from companion.core.consensus.law import FormationState
from companion.core.consensus.peers import PeerState
from companion.core.formation.paths import Path, gentle_path, offset_from
from companion.core.reference.blend import SAMPLES
from companion.geometry.turning import in_formation_frame
from companion.geometry.vectors import mean
from companion.types.flight import FlightPhase
from companion.types.formation import Heading
from companion.types.notices import Code, Refused
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

JOINS_AFTER_S = 2.0  # a peer in formation for longer did not form together with this vehicle


class Joining:
    """Since when each peer has been in formation, and the path to the own slot among them."""

    def __init__(self, own_id: int, separation_m: float, speed_m_s: float) -> None:
        self._own_id = own_id
        self._separation_m = separation_m
        self._speed_m_s = speed_m_s
        self._since_s: dict[int, float] = {}
        self._formed: list[int] = []  # its keys

    def update(self, now_s: float, flying: Iterable[PeerPacket]) -> None:
        """Once a tick, with all fresh peers that fly."""
        formed = [p.vehicle_id for p in flying if p.phase is FlightPhase.FORMATION]
        if formed != self._formed:
            self._formed, since_s = formed, self._since_s
            self._since_s = {vehicle_id: since_s.get(vehicle_id, now_s) for vehicle_id in formed}

    def is_due(self, now_s: float) -> bool:
        """Whether a peer has been in formation long enough for this vehicle to join it."""
        return any(now_s - since_s > JOINS_AFTER_S for since_s in self._since_s.values())

    def path(
        self,
        now_s: float,
        position_enu_m: Vector3,
        velocity_enu_m_s: Vector3,
        slot: Vector3,
        heading: Heading,
        peers: Collection[PeerState],
    ) -> Path:
        """delta from this position and velocity to `slot`, in the formation's own frame, which has this heading.

        `peers` are all that fly. Raises Refused without a vehicle in formation, or where separation_m would not be kept.
        """
        formed = [peer for peer in peers if peer.packet.phase is FlightPhase.FORMATION]
        self._refuse_while_others_move(peers)
        if not formed:
            raise Refused(Code.NO_FORMATION_TO_JOIN, "no vehicle is in formation any more")
        fleet = mean_state([peer.formation_state_at(now_s) for peer in formed])
        for peer in formed:
            apart_m = dist(slot, in_formation_frame(peer.slot_at(now_s).position_enu_m, heading))
            if apart_m < self._separation_m:
                text = f"its slot is taken: vehicle {peer.packet.vehicle_id} flies {apart_m:.2f} m from it"
                raise Refused(Code.SLOT_TAKEN, text)
        delta, lasts_s = gentle_path(
            offset_from(position_enu_m, velocity_enu_m_s, fleet, slot, heading), self._speed_m_s
        )
        x, y, z = fleet.position_enu_m
        points = [delta(lasts_s * k / SAMPLES)[0] for k in range(SAMPLES + 1)]
        for peer in peers:
            px, py, pz = peer.position_at(now_s)
            dx, dy, dz = in_formation_frame((px - x, py - y, pz - z), heading)
            there = (dx - slot[0], dy - slot[1], dz - slot[2])
            apart_m = min(dist(point, there) for point in points)
            if apart_m < self._separation_m:
                raise Refused(
                    Code.PATH_TOO_CLOSE,
                    f"the path to its slot comes within {apart_m:.2f} m of vehicle {peer.packet.vehicle_id};"
                    f" expected at least separation_m, {self._separation_m:g} m",
                )
        return delta, lasts_s

    def _refuse_while_others_move(self, peers: Iterable[PeerState]) -> None:
        """Raises Refused while another vehicle moves within the formation or joins: vehicles join one at a time."""
        for packet in (peer.packet for peer in peers):
            slot = packet.slot
            if packet.phase is FlightPhase.FORMATION and (slot.moves or slot.waiting != slot.formation):
                text = f"vehicle {packet.vehicle_id} is not in its slot yet; give form again then"
                raise Refused(Code.PEER_STILL_JOINING, text)
            if packet.phase is FlightPhase.ENGAGE and packet.vehicle_id < self._own_id:
                text = f"vehicle {packet.vehicle_id} is joining; give form again then"
                raise Refused(Code.PEER_STILL_JOINING, text)


def mean_state(states: Collection[FormationState]) -> FormationState:
    """Mean RFT state over one or more vehicles."""
    return FormationState(mean([s.position_enu_m for s in states]), mean([s.velocity_enu_m_s for s in states]))
