"""What a vehicle knows of the others: believable peers -> neighbours, PrC and the leader's word, once a tick."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from companion.core.formation import Place, place
from companion.core.leader_word import LeaderWatch
from companion.core.neighbours import NeighbourRule
from companion.core.peers import PeerTable
from companion.core.priority import next_prc
from companion.types import FlightPhase, LeaderWord, PeerPacket, ReceivedPeerPacket, Role, Vector3

# A vehicle on the ground, climbing, landing or flown by its pilot is nobody's neighbour.
COOPERATING = frozenset({FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE})


@dataclass(frozen=True, slots=True)
class Neighbourhood:
    """One tick's outcome: own PrC and leader's word, and every neighbour with its PrC and place."""

    prc: int
    leader_word: LeaderWord | None  # None where no living leader is heard
    leader_word_age_s: float
    neighbours: tuple[tuple[int, Place], ...]  # (PrC, place)
    neighbour_ids: tuple[int, ...]


class Cooperation:
    """`slots` holds d_i0 of every vehicle of the fleet; its length is n of Algorithm 1."""

    def __init__(
        self,
        own_id: int,
        role: Role,
        slots_enu_m: Mapping[int, Vector3],
        peers: PeerTable,
        rule: NeighbourRule,
        leader: LeaderWatch,
    ) -> None:
        self._own_id = own_id
        self._role = role
        self._slots_enu_m = slots_enu_m
        self._rule = rule
        self._leader = leader
        self.peers = peers

    def update(self, now_s: float, own_position_enu_m: Vector3, packets: Iterable[ReceivedPeerPacket]) -> Neighbourhood:
        """Algorithm 1 and the neighbour set, from the packets that came since the last tick."""
        self.peers.fold(packets)
        flying = {i: peer for i, peer in self.peers.fresh(now_s).items() if peer.packet.phase in COOPERATING}
        positions = {i: peer.position_at(now_s) for i, peer in flying.items()}
        ids = self._rule.select(own_position_enu_m, positions)
        leads = self._role is Role.LEADER
        heard = [(flying[i].packet, positions[i], self._slots_enu_m[i]) for i in ids]
        own = [LeaderWord(self._own_id, 0, int(now_s * 1000.0))] if leads else []
        self._leader.hear(now_s, own or [packet.leader_word for packet, _, _ in heard])
        leader_word, leader_word_age_s = self._leader.youngest(now_s)
        return Neighbourhood(
            prc=next_prc(leads, [packet.prc for packet, _, _ in heard], len(self._slots_enu_m)),
            leader_word=leader_word,
            leader_word_age_s=leader_word_age_s,
            neighbours=tuple([(packet.prc, _place(packet, at, slot)) for packet, at, slot in heard]),
            neighbour_ids=ids,
        )


def _place(packet: PeerPacket, position_enu_m: Vector3, slot_enu_m: Vector3) -> Place:
    return place(position_enu_m, packet.velocity_enu_m_s, slot_enu_m, packet.acceleration_enu_m_s2)
