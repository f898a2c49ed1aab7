"""Formations that leaders pass on to whoever does not have them; and of several leaders, whose word counts."""

from __future__ import annotations

from collections.abc import Iterable

from companion.types import FlightPhase, FormationChange, PeerPacket, Role, Term


def first_leader(flying: Iterable[PeerPacket], own_id: int | None) -> int | None:
    """The smallest id of those that lead in formation; `own_id` is given where this vehicle does. None where nobody does."""
    ids = [packet.vehicle_id for packet in flying if _leads(packet)]
    return min(ids if own_id is None else [*ids, own_id], default=None)


def passed_on(flying: Iterable[PeerPacket], term: Term, stands: bool) -> list[tuple[int, FormationChange]]:
    """(by whom, what), by those that lead in this term, the smallest id first.

    To a vehicle that `stands` on the ground only what is flown already: it has nothing to begin.
    """
    return [
        (packet.vehicle_id, packet.change)
        for packet in sorted(flying, key=lambda packet: packet.vehicle_id)
        if packet.change and _leads(packet) and packet.leader_word and packet.leader_word.term == term
        if not stands or packet.change.number == packet.slot.formation
    ]


def _leads(packet: PeerPacket) -> bool:
    return packet.role is Role.LEADER and packet.phase is FlightPhase.FORMATION
