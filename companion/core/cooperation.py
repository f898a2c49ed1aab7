"""What a vehicle knows of the others: believable peers -> neighbours, PrC and the leader's word, once a tick."""

from __future__ import annotations

from collections.abc import Iterable

from msgspec import Struct
from msgspec.structs import replace

from companion.core.formation import Place, place
from companion.core.leader_word import LeaderWatch
from companion.core.leadership import Leadership
from companion.core.neighbours import NeighbourRule
from companion.core.peers import MAX_TURN_RAD_S, PeerTable
from companion.core.priority import next_prc
from companion.core.reference_clock import WAITED_S, ReferenceClock
from companion.core.succession import Succession
from companion.geometry.turning import heading_after
from companion.types import (
    FlightPhase,
    Heading,
    HealthFlag,
    LeaderWord,
    PeerPacket,
    ReceivedPeerPacket,
    Role,
    Term,
    Vector3,
)

LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION
# A vehicle on the ground, climbing, landing or flown by its pilot is nobody's neighbour.
FORMING_S = 2.0  # so long a formation may take to come together
COOPERATING = frozenset({FlightPhase.HOLD, FlightPhase.ENGAGE, FlightPhase.FORMATION, FlightPhase.RELEASE})


class Neighbourhood(Struct, frozen=True, gc=False):
    """One tick's outcome: own role, PrC and leader's word, and every neighbour with its PrC and place."""

    role: Role
    epoch: int
    reference_s: float  # how far into the RFT the fleet is, as far as this vehicle knows
    prc: int
    leader_word: LeaderWord | None  # None where no living leader is heard
    leader_word_age_s: float
    leaderless: (
        HealthFlag | None
    )  # LEADER_AWAITED: followers hold formation among themselves; LEADER_LOST: for too long
    neighbours: tuple[tuple[int, Place], ...]  # (PrC, place)
    neighbour_ids: tuple[int, ...]
    flying: tuple[PeerPacket, ...]  # all others that are heard of and cooperate
    heading: Heading | None  # of the formation, as it is heard; None where it is this vehicle's to say


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
        succession: Succession,
    ) -> None:
        self._own_id = own_id
        self._n = n
        self._rule = rule
        self._leader = leader
        self._succession = succession
        self._clock = ReferenceClock()
        self._formed_s: float | None = None  # since when this vehicle is in formation
        self.leadership = leadership
        self.peers = peers

    def update(
        self,
        now_s: float,
        own_position_enu_m: Vector3,
        packets: Iterable[ReceivedPeerPacket],
        in_formation: bool,
        fit_to_lead: bool,
    ) -> Neighbourhood:
        """Algorithm 1 and the neighbour set, from the packets that came since the last tick.

        `in_formation`: the RFT's time runs for this vehicle. `fit_to_lead`: it flies in formation, nothing is wrong with it.
        """
        self.peers.fold(packets, self.leadership.epoch)
        fresh = self.peers.fresh(now_s)
        self.leadership.hear([peer.packet.leader_word for peer in fresh.values()])
        flying = [peer.packet for peer in fresh.values() if peer.packet.phase in COOPERATING]
        company = self._company(now_s, flying, in_formation)
        positions = {p.vehicle_id: fresh[p.vehicle_id].position_at(now_s) for p in company}
        ids = self._rule.select(own_position_enu_m, positions)
        heard = [fresh[i].packet for i in ids]
        self._leader.hear(now_s, self._words_of_others(heard), self.leadership.term)
        newest = self._leader.youngest(now_s)
        leaderless = self._succeed(now_s, newest[0] is not None, heard, flying, fit_to_lead)
        role, term = self.leadership.role, self.leadership.term
        prcs = [self._prc_of(packet, term) for packet in heard]
        heading = self._heard_heading(role, in_formation, *newest)
        word, word_age_s, reference_s = self._word(now_s, role, in_formation, *newest)
        return Neighbourhood(
            role=role,
            epoch=self.leadership.epoch,
            reference_s=reference_s,
            prc=next_prc(role is LEADER, prcs, self._n),
            leader_word=word,
            leader_word_age_s=word_age_s,
            leaderless=leaderless if word is None else None,
            neighbours=tuple(
                [
                    (prc, place(positions[i], p.velocity_enu_m_s, fresh[i].slot_at(now_s), p.acceleration_enu_m_s2))
                    for i, prc, p in zip(ids, prcs, heard, strict=True)
                ]
            ),
            neighbour_ids=ids,
            flying=tuple(flying),
            heading=heading,
        )

    def _company(self, now_s: float, flying: list[PeerPacket], in_formation: bool) -> list[PeerPacket]:
        """Who can be a neighbour. Once a formation has come together, who is not in it is not heeded any more, or not yet.

        But for a leader, where none leads in formation: it may have left because it was told to, and the fleet stands with it.
        """
        if not in_formation:
            self._formed_s = None
            return flying
        if self._formed_s is None:
            self._formed_s = now_s
        if now_s - self._formed_s <= FORMING_S:
            return flying
        led = self.leadership.role is LEADER or any(p.role is LEADER and p.phase is FORMATION for p in flying)
        return [p for p in flying if p.phase is FORMATION or (p.role is LEADER and not led)]

    def landed(self) -> None:
        """The next flight begins the RFT anew."""
        self._clock.begin_anew()

    def _succeed(
        self, now_s: float, led: bool, heard: list[PeerPacket], flying: list[PeerPacket], fit_to_lead: bool
    ) -> HealthFlag:
        """Take the lead where nobody has it and it is this vehicle's turn. What it is to have none now, should that be so.

        Nobody's leader it never becomes: who has lost all its neighbours may be the one that is lost, and does not wait for its
        turn. Not while a leader is heard that only no neighbour passes on: it lives. And not without knowing how far into the
        RFT the fleet is.
        """
        led = led or self.leadership.role is LEADER
        in_company = any(packet.phase is FORMATION for packet in heard)
        awaits = self._succession.awaits(now_s, self.leadership.term, led, in_company)
        rank = self._succession.rank_in_turn(now_s)
        if rank and awaits and fit_to_lead and self._clock.has_run and not self._leads_in(flying):
            self.leadership.take(rank)
        return HealthFlag.LEADER_AWAITED if awaits else HealthFlag.LEADER_LOST

    def _leads_in(self, flying: list[PeerPacket]) -> bool:
        """Are those who lead among them? Not such as have not heard yet that they lead no more."""
        term = self.leadership.term
        return any(p.role is LEADER and p.leader_word is not None and p.leader_word.term >= term for p in flying)

    def _prc_of(self, packet: PeerPacket, term: Term) -> int:
        """Who leads by an older term has not heard of the change yet: until it has, it counts as far from any leader."""
        if packet.prc == 1 and packet.leader_word is not None and packet.leader_word.term < term:
            return self._n
        return packet.prc

    def _words_of_others(self, packets: Iterable[PeerPacket]) -> list[LeaderWord]:
        """What this vehicle once said itself, as a leader or before a restart, is nobody's word now."""
        own_id = self._own_id
        return [word for p in packets if (word := p.leader_word) is not None and word.leader_id != own_id]

    def _heard_heading(self, role: Role, in_formation: bool, word: LeaderWord | None, age_s: float) -> Heading | None:
        """What the word says, by now. Who leads heeds another that flies the RFT already, or of several the first by id."""
        if word is None or word.leader_id == self._own_id:
            return None
        if role is LEADER:
            of_one_lead = word.term == self.leadership.term and word.reference_s > 0.0
            if not of_one_lead or (in_formation and word.leader_id > self._own_id):
                return None
        heading = heading_after(word.heading, age_s + WAITED_S)
        most = MAX_TURN_RAD_S  # what peers believe: no word may make its bearer unbelievable
        return replace(heading, rate_rad_s=min(max(heading.rate_rad_s, -most), most))

    def _word(
        self, now_s: float, role: Role, in_formation: bool, word: LeaderWord | None, age_s: float
    ) -> tuple[LeaderWord | None, float, float]:
        """The word to pass on, how old it is, and how far into the RFT the fleet is; `word` is the youngest that was heard."""
        of_other = word if word is not None and word.leader_id != self._own_id else None
        if role is LEADER:
            lead, stamp = self.leadership, int(now_s * 1000.0)
            if in_formation and of_other and (of_other.term != lead.term or of_other.leader_id > self._own_id):
                of_other = None
            reference_s = self._clock.lead(now_s, in_formation, of_other, age_s)
            own = LeaderWord(self._own_id, lead.epoch, stamp, reference_s if in_formation else 0.0, lead.claim)
            self._leader.hear(now_s, [own], lead.term)  # should it have to follow, this is the last word it heard
            return own, 0.0, reference_s
        reference_s = self._clock.update(now_s, in_formation, of_other, age_s)
        if word is None:
            return None, age_s, reference_s
        told_s = reference_s if self._clock.runs else 0.0
        return LeaderWord(word.leader_id, word.epoch, word.stamp, told_s, word.claim), age_s, reference_s
