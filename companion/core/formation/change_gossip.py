"""Formation changes that leaders pass on, and which of several leaders comes first."""

from __future__ import annotations

from collections.abc import Iterable

from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationChange, Term
from companion.types.peers import PeerPacket


def first_leader(flying: Iterable[PeerPacket], own_id: int | None) -> int | None:
    """The smallest id of all leaders in formation; None without one. `own_id`: this vehicle, where it is one of them."""
    ids = [packet.vehicle_id for packet in flying if _leads(packet)]
    return min(ids if own_id is None else [*ids, own_id], default=None)


def passed_on(flying: Iterable[PeerPacket], term: Term, on_ground: bool) -> list[tuple[int, FormationChange]]:
    """(leader, change) from the leaders of this term, the smallest id first.

    A vehicle `on_ground` adopts only the formation that the leader flies already, not one that is still to begin.
    """
    changes = [
        (packet.vehicle_id, packet.change)
        for packet in flying
        if packet.change and _leads(packet) and packet.leader_beacon and packet.leader_beacon.term == term
        if not on_ground or packet.change.number == packet.slot.formation
    ]
    changes.sort(key=lambda change: change[0])
    return changes


def _leads(packet: PeerPacket) -> bool:
    return packet.role is Role.LEADER and packet.phase is FlightPhase.FORMATION
