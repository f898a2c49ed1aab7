"""What a vehicle knows of the others: believable peers -> neighbours, PrC and the leader's word, once a tick."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct

from companion.core.formation import Place, place
from companion.core.leader_word import LeaderWatch
from companion.core.leadership import Leadership
from companion.core.neighbours import NeighbourRule
from companion.core.peers import PeerTable
from companion.core.priority import next_prc
from companion.core.reference_clock import ReferenceClock
from companion.types import FlightPhase, LeaderWord, PeerPacket, ReceivedPeerPacket, Role, Vector3

LEADER = Role.LEADER
# A vehicle on the ground, climbing, landing or flown by its pilot is nobody's neighbour.
COOPERATING = frozenset({FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE})


class Neighbourhood(Struct, frozen=True, gc=False):
    """One tick's outcome: own role, PrC and leader's word, and every neighbour with its PrC and place."""

    role: Role
    epoch: int
    reference_s: float  # how far into the RFT the fleet is, as far as this vehicle knows
    prc: int
    leader_word: LeaderWord | None  # None where no living leader is heard
    leader_word_age_s: float
    neighbours: tuple[tuple[int, Place], ...]  # (PrC, place)
    neighbour_ids: tuple[int, ...]
    flying: tuple[PeerPacket, ...]  # all others that are heard of and cooperate


class Cooperation:
    """`n` is that of Algorithm 1, the number of vehicles."""

    def __init__(
        self,
        own_id: int,
        leadership: Leadership,
        n: int,
        peers: PeerTable,
        rule: NeighbourRule,
        leader: LeaderWatch,
    ) -> None:
        self._own_id = own_id
        self._n = n
        self._rule = rule
        self._leader = leader
        self._clock = ReferenceClock()
        self.leadership = leadership
        self.peers = peers

    def update(
        self,
        now_s: float,
        own_position_enu_m: Vector3,
        packets: Iterable[ReceivedPeerPacket],
        in_formation: bool,
    ) -> Neighbourhood:
        """Algorithm 1 and the neighbour set, from the packets that came since the last tick."""
        self.peers.fold(packets, self.leadership.epoch)
        fresh = self.peers.fresh(now_s)
        self.leadership.hear([peer.packet.leader_word for peer in fresh.values()])
        role, epoch = self.leadership.role, self.leadership.epoch
        positions = {i: peer.position_at(now_s) for i, peer in fresh.items() if peer.packet.phase in COOPERATING}
        ids = self._rule.select(own_position_enu_m, positions)
        heard = [fresh[i].packet for i in ids]
        prcs = [self._prc_of(packet, epoch) for packet in heard]
        self._leader.hear(now_s, self._words_of_others(heard), epoch)
        word, word_age_s, reference_s = self._word(now_s, role, epoch, in_formation)
        return Neighbourhood(
            role=role,
            epoch=epoch,
            reference_s=reference_s,
            prc=next_prc(role is LEADER, prcs, self._n),
            leader_word=word,
            leader_word_age_s=word_age_s,
            neighbours=tuple(
                [
                    (prc, place(positions[i], p.velocity_enu_m_s, fresh[i].slot_at(now_s), p.acceleration_enu_m_s2))
                    for i, prc, p in zip(ids, prcs, heard, strict=True)
                ]
            ),
            neighbour_ids=ids,
            flying=tuple([fresh[i].packet for i in positions]),
        )

    def landed(self) -> None:
        """The next flight begins the RFT anew."""
        self._clock.begin_anew()

    def _prc_of(self, packet: PeerPacket, epoch: int) -> int:
        """Who leads in an older epoch has not heard of the change yet: until it has, it counts as far from any leader."""
        if packet.prc == 1 and packet.leader_word is not None and packet.leader_word.epoch < epoch:
            return self._n
        return packet.prc

    def _words_of_others(self, packets: Iterable[PeerPacket]) -> list[LeaderWord]:
        """What this vehicle once said itself, as a leader or before a restart, is nobody's word now."""
        own_id = self._own_id
        return [word for p in packets if (word := p.leader_word) is not None and word.leader_id != own_id]

    def _word(self, now_s: float, role: Role, epoch: int, in_formation: bool) -> tuple[LeaderWord | None, float, float]:
        """The word to pass on, how old it is, and how far into the RFT the fleet is."""
        word, age_s = self._leader.youngest(now_s)
        of_other = word if word is not None and word.leader_id != self._own_id else None
        if role is LEADER:
            reference_s = self._clock.lead(now_s, in_formation, of_other, age_s)
            own = LeaderWord(self._own_id, epoch, int(now_s * 1000.0), reference_s if in_formation else 0.0)
            self._leader.hear(now_s, [own], epoch)  # should it have to follow, this is the last word it heard
            return own, 0.0, reference_s
        reference_s = self._clock.update(now_s, in_formation, of_other, age_s)
        if word is None:
            return None, age_s, reference_s
        told_s = reference_s if self._clock.runs else 0.0
        return LeaderWord(word.leader_id, word.epoch, word.stamp, told_s), age_s, reference_s
