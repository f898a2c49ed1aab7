"""Consensus: accepted peer packets -> neighbours, PrC and leader beacon, once a tick."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import inf

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.law import FormationState, next_prc
from companion.core.consensus.neighbours import NeighbourRule
from companion.core.consensus.peers import MAX_TURN_RAD_S, PeerState, PeerTable
from companion.core.election.beacon import WAITED_S, BeaconMonitor, MissionClock
from companion.core.election.leadership import Leadership, Succession, refusal_of_lead
from companion.geometry.formations import heading_after
from companion.geometry.vectors import clamped
from companion.types.autopilot import VehicleState
from companion.types.commands import EPOCHS_AHEAD, NUMBERS_AHEAD, Command, Lead
from companion.types.flight import COOPERATING, STREAMING, Flight, FlightPhase, HealthFlag, Role
from companion.types.formation import Heading, LeaderBeacon, Term
from companion.types.notices import Answer, Notice
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.types.values import Vector3

# Member lookup of an enum is slow, and every tick needs these.
LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION
LEADER_AWAITED, LEADER_LOST = HealthFlag.LEADER_AWAITED, HealthFlag.LEADER_LOST
EPOCHS_PER_S = 1.0  # changes of leader that may be missed in time
FORMING_S = 2.0  # so long a formation may take to come together


class LeadView(Struct, frozen=True, gc=False):
    """The own role and term, and what this vehicle knows of its leader.

    `beacon` is the one to pass on, None without a fresh leader. `heading` is that of the formation as peers report it, None
    where this vehicle decides it. `reference_s` is mission time, as far as this vehicle knows: how far the fleet is in the RFT.
    """

    role: Role
    term: Term
    beacon: LeaderBeacon | None
    beacon_age_s: float
    leaderless: (
        HealthFlag | None
    )  # LEADER_AWAITED: followers hold formation among themselves; LEADER_LOST: for too long
    reference_s: float
    heading: Heading | None


class Neighbours(Struct, frozen=True, gc=False):
    """The neighbours that the law follows: their ids, and (PrC, formation state) of each in the same order."""

    ids: tuple[int, ...] = ()
    states: tuple[tuple[int, FormationState], ...] = ()

    @property
    def prcs(self) -> list[int]:
        """In the order of `ids`."""
        return [prc for prc, _ in self.states]


class PeerSets(Struct, frozen=True, gc=False):
    """Peers by id, from all that were ever heard to those that count most; the theory of the stage has the sets."""

    known: Mapping[int, PeerState] = {}  # the last packet of every peer, however old
    present: Mapping[int, PeerState] = {}  # the fresh ones, and the distant ones that are in time at 5 Hz
    fresh: Mapping[int, PeerState] = {}  # received at 50 Hz and in time: law and separation filter use these
    flying: tuple[PeerPacket, ...] = ()  # the present ones in a cooperating phase
    ground_position_enu_m: Mapping[int, Vector3] = {}  # where each peer was last on the ground
    duplicate_id_s: float = -inf  # when a packet of a second agent with a known id last came
    rejected: Mapping[str, int] = {}

    @property
    def packets(self) -> tuple[PeerPacket, ...]:
        """The packets of all present peers, in every phase."""
        return tuple([peer.packet for peer in self.present.values()])


class Consensus(Struct, frozen=True, gc=False):
    """Own PrC, leader, neighbours and peers of this tick; answers to commands and events."""

    prc: int
    lead: LeadView
    neighbours: Neighbours
    peers: PeerSets
    answers: tuple[tuple[int, Answer], ...] = ()
    events: tuple[Notice, ...] = ()


def _states_of(
    candidates: Sequence[PeerPacket], fresh: dict[int, PeerState], present: dict[int, PeerState]
) -> dict[int, PeerState]:
    """The fresh ones of the candidates, which are some of the present peers."""
    if len(candidates) == len(fresh) and present is fresh:  # the usual case: all of them
        return fresh
    return {p.sender.vehicle_id: fresh[p.sender.vehicle_id] for p in candidates if p.sender.vehicle_id in fresh}


def _attracting(ids: tuple[int, ...], packets: Sequence[PeerPacket], leads: bool) -> tuple[int, ...]:
    """Which of these neighbours the law uses: those that form or fly in formation. `packets` are in the same order.

    A vehicle in hold may not have been commanded to form: where it is says nothing about the formation. Only a leader in hold
    counts, where no other leads: the fleet waits with it. `leads`: this vehicle is leader.
    """
    streaming = [p for p in packets if p.phase in STREAMING]
    if len(streaming) == len(packets):
        return ids
    led = leads or any(p.role is LEADER for p in streaming)
    return tuple([p.sender.vehicle_id for p in packets if p.phase in STREAMING or (p.role is LEADER and not led)])


class ConsensusStage:
    """Fresh peers -> leadership, mission time, neighbours and PrC. `n` of Algorithm 1 is the number of vehicles."""

    def __init__(
        self,
        own_id: int,
        leadership: Leadership,
        n: int,
        peers: PeerTable,
        rule: NeighbourRule,
        leader: BeaconMonitor,
        succession: Succession,
    ) -> None:
        self._own_id = own_id
        self._n = n
        self._rule = rule
        self._leader = leader
        self._succession = succession
        self._clock = MissionClock()
        self._led_s = -inf  # when a leader of the own term was last known
        self._formed_s: float | None = None  # since when this vehicle is in formation
        self.leadership = leadership
        self.peers = peers

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        packets: Iterable[ReceivedPeerPacket],
        commands: Collection[Command] = (),
        refusal_to_lead: Notice | None = None,
        fit_to_lead: bool = False,
        distant: frozenset[int] = frozenset(),
    ) -> Consensus:
        """Algorithm 1 and the neighbour set, from the packets since the last tick.

        A commanded role comes first: one tick, its packet included, is of one role. `refusal_to_lead` is why this vehicle
        must not become leader, `fit_to_lead` that it flies in formation without a failsafe, `distant` the peers that are
        received at 5 Hz; all of the last tick.
        """
        answers, events = self._command_leads(now_s, commands, vehicle, flight, refusal_to_lead)
        self._clock.on_ground = not vehicle.armed
        leadership, in_formation = self.leadership, flight.in_formation
        self.peers.set_low_rate_peers(now_s, distant)
        fresh, present, changes = self._receive(now_s, packets)
        events += changes
        flying = [peer.packet for peer in present.values() if peer.packet.phase in COOPERATING]
        candidates = self._candidates(now_s, flying, in_formation)
        ids = self._rule.select(vehicle.position_enu_m, _states_of(candidates, fresh, present), now_s)
        packets_of_neighbours = [fresh[i].packet for i in ids]
        with_neighbours = FORMATION in [packet.phase for packet in packets_of_neighbours]
        beacons = self._beacons_of_others(packets_of_neighbours)
        self._leader.receive(now_s, beacons, leadership.term)
        newest = self._leader.youngest(now_s)
        events += self._settle_term(now_s, in_formation, newest[0], flying)
        leaderless, claimed = self._succeed(now_s, newest[0] is not None, with_neighbours, flying, fit_to_lead)
        role, term = leadership.role, leadership.term
        ids = _attracting(ids, packets_of_neighbours, role is LEADER) if in_formation else ids
        neighbours = self._neighbours(now_s, [fresh[i] for i in ids], term)
        heading = self._received_heading(role, in_formation, *newest)
        beacon, beacon_age_s, reference_s = self._beacon(now_s, role, in_formation, *newest)
        prc = next_prc(role is LEADER, [prc for prc, _ in neighbours], self._n)
        table = self.peers
        return Consensus(
            prc=prc,
            lead=LeadView(
                role=role,
                term=term,
                beacon=beacon,
                beacon_age_s=beacon_age_s,
                leaderless=leaderless if beacon is None else None,
                reference_s=reference_s,
                heading=heading,
            ),
            neighbours=Neighbours(ids, neighbours),
            peers=PeerSets(
                known=dict(table.known),
                present=present,
                fresh=fresh,
                flying=tuple(flying),
                ground_position_enu_m=dict(table.ground_position_enu_m),
                duplicate_id_s=table.duplicate_id_s,
                rejected=table.rejected,
            ),
            answers=answers,
            events=events + claimed,
        )

    def _receive(
        self, now_s: float, packets: Iterable[ReceivedPeerPacket]
    ) -> tuple[dict[int, PeerState], dict[int, PeerState], tuple[Notice, ...]]:
        """The fresh peers by id, those that are present, and the events of the changes of the lead that they report."""
        epochs_up_to = self._epochs_up_to(now_s)
        self.peers.fold(packets, epochs_up_to)
        fresh = self.peers.fresh(now_s)
        present = self.peers.present(now_s, fresh)
        events: tuple[Notice, ...] = ()
        for peer in present.values():
            if self.leadership.term < peer.term and peer.term[0] <= epochs_up_to:  # a command may just have lowered it
                events += self.leadership.receive(now_s, [peer.packet.leader.beacon])
        return fresh, present, events

    def _epochs_up_to(self, now_s: float) -> int:
        """The largest epoch to accept: the changes that this vehicle may have missed since it last knew its leader."""
        missed = EPOCHS_AHEAD + EPOCHS_PER_S * (now_s - self._led_s)
        return self.leadership.epoch + (int(missed) if missed < NUMBERS_AHEAD else NUMBERS_AHEAD)

    def _settle_term(
        self, now_s: float, in_formation: bool, newest: LeaderBeacon | None, flying: Iterable[PeerPacket]
    ) -> tuple[Notice, ...]:
        """Return to the term before where no leader of the new one is alive. The event of a change of role.

        Any vehicle shows that the leader is alive: a vehicle out of formation may have no neighbours, and over many hops a
        beacon needs longer than a packet that this vehicle receives itself.
        """
        is_leader, led = self.leadership.role is LEADER, newest is not None and newest.term == self.leadership.term
        if led if not is_leader else in_formation:  # a leader on the ground may have restarted, and missed changes
            self._led_s = now_s
        if self.leadership.is_settled:
            return ()
        return self.leadership.settle(now_s, [p.leader.beacon for p in flying if p.leader.beacon is not None])

    def _beacons_of_others(self, packets: Iterable[PeerPacket]) -> list[LeaderBeacon]:
        """The leader beacons in these packets. The own beacon is from before a handover or a restart: left out."""
        beacons = []
        for packet in packets:
            beacon = packet.leader.beacon
            if beacon is not None and beacon.leader_id != self._own_id:
                beacons.append(beacon)
        return beacons

    def _neighbours(
        self, now_s: float, peers: Iterable[PeerState], term: Term
    ) -> tuple[tuple[int, FormationState], ...]:
        """(PrC, state) of each neighbour. A leader of an older term has not received the change yet: its PrC is n."""
        neighbours = []
        for peer in peers:
            is_deposed = peer.packet.leader.prc == 1 and peer.term < term
            neighbours.append((self._n if is_deposed else peer.packet.leader.prc, peer.formation_state_at(now_s)))
        return tuple(neighbours)

    def _command_leads(
        self,
        now_s: float,
        commands: Collection[Command],
        vehicle: VehicleState,
        flight: Flight,
        refusal_to_lead: Notice | None,
    ) -> tuple[tuple[tuple[int, Answer], ...], tuple[Notice, ...]]:
        """The answers by command number, and the events of a change of role."""
        if not commands:
            return (), ()
        answers: list[tuple[int, Answer]] = []
        events: list[Notice] = []
        for command in commands:
            if isinstance(command.content, Lead):
                lowers = command.content.epoch < self.leadership.epoch
                answer, changes = self._command_lead(command.content, vehicle, flight, refusal_to_lead)
                if lowers and answer.accepted:
                    self._led_s = now_s  # peers in the epoch left are not believed
                answers.append((command.number, answer))
                events += changes
        return tuple(answers), tuple(events)

    def _command_lead(
        self, lead: Lead, vehicle: VehicleState, flight: Flight, refusal_to_lead: Notice | None
    ) -> tuple[Answer, tuple[Notice, ...]]:
        refusal = refusal_of_lead(flight, vehicle)
        if not refusal and refusal_to_lead and self._own_id in lead.leaders:
            refusal = refusal_to_lead.about("lead")
        return (Answer(False, refusal), ()) if refusal else self.leadership.command(lead)

    def _candidates(self, now_s: float, flying: list[PeerPacket], in_formation: bool) -> list[PeerPacket]:
        """Peers whose beacons are passed on. Once a formation has come together, only vehicles in it are used.

        A leader out of formation is used where none leads in it: it left by command, and the fleet waits with it.
        """
        if not in_formation:
            self._formed_s = None
            return flying
        if self._formed_s is None:
            self._formed_s = now_s
        if now_s - self._formed_s <= FORMING_S:
            return flying
        formed = [p for p in flying if p.phase is FORMATION]
        if len(formed) == len(flying):
            return flying
        led = self.leadership.role is LEADER or LEADER in [p.role for p in formed]
        return [p for p in flying if p.phase is FORMATION or (p.role is LEADER and not led)]

    def _succeed(
        self, now_s: float, led: bool, with_neighbours: bool, flying: list[PeerPacket], fit_to_lead: bool
    ) -> tuple[HealthFlag, tuple[Notice, ...]]:
        """Become leader where there is none and it is this vehicle's turn. Returns the flag without a leader, and events.

        A vehicle that has lost all its neighbours may be the one that is lost: it does not wait for its turn. No successor
        takes over while it receives a leader that no neighbour passes on, nor without a known mission time.
        """
        led = led or self.leadership.role is LEADER
        if not self._succession.awaits(now_s, self.leadership.term, led, with_neighbours):
            return LEADER_LOST, ()
        may_take = not led and fit_to_lead and self._clock.has_run
        if may_take and (rank := self._succession.rank_in_turn(now_s)) and not self._leads_in(flying):
            return LEADER_AWAITED, self.leadership.claim(rank)
        return LEADER_AWAITED, ()

    def _leads_in(self, flying: list[PeerPacket]) -> bool:
        """Whether a leader of this term or a newer one flies; a leader of an older term does not know the change yet."""
        term = self.leadership.term
        return any(p.role is LEADER and p.leader.beacon is not None and p.leader.beacon.term >= term for p in flying)

    def _received_heading(
        self, role: Role, in_formation: bool, newest: LeaderBeacon | None, age_s: float
    ) -> Heading | None:
        """Heading in the beacon, extrapolated to now. A leader uses that of one already in the RFT, or of the smallest id."""
        if newest is None or newest.leader_id == self._own_id:
            return None
        if role is LEADER:
            of_own_term = newest.term == self.leadership.term and newest.reference_s > 0.0
            if not of_own_term or (in_formation and newest.leader_id > self._own_id):
                return None
        heading = heading_after(newest.heading, age_s + WAITED_S)
        most = MAX_TURN_RAD_S  # the limit of what peers accept: a beacon passed on must not get this vehicle rejected
        if -most <= heading.rate_rad_s <= most:
            return heading
        return replace(heading, rate_rad_s=clamped(heading.rate_rad_s, most))

    def _beacon(
        self, now_s: float, role: Role, in_formation: bool, newest: LeaderBeacon | None, age_s: float
    ) -> tuple[LeaderBeacon | None, float, float]:
        """The beacon to pass on, its age, and mission time; `newest` is the youngest received beacon."""
        of_other = newest if newest is not None and newest.leader_id != self._own_id else None
        if role is LEADER:
            lead, stamp = self.leadership, int(now_s * 1000.0)
            if in_formation and of_other and (of_other.term != lead.term or of_other.leader_id > self._own_id):
                of_other = None
            reference_s = self._clock.lead(now_s, in_formation, of_other, age_s)
            own = LeaderBeacon(self._own_id, lead.epoch, stamp, reference_s if in_formation else 0.0, lead.claim_rank)
            self._leader.receive(now_s, [own], lead.term)  # its last beacon, should it become a follower
            return own, 0.0, reference_s
        reference_s = self._clock.update(now_s, in_formation, of_other, age_s)
        if newest is None:
            return None, age_s, reference_s
        reported_s = reference_s if self._clock.runs else 0.0
        if not self._clock.runs and of_other and of_other.reference_s > 0.0:  # not believed yet: passed on unchanged
            reported_s = of_other.reference_s + age_s + WAITED_S
        return LeaderBeacon(newest.leader_id, newest.epoch, newest.stamp, reported_s, newest.claim), age_s, reference_s
