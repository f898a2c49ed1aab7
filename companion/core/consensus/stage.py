"""Consensus: accepted peer packets -> leader, mission time, neighbours and PrC, once a tick.

The problem. No vehicle knows the fleet. Each hears some others, late, with losses, and each other vehicle hears a different
part. From that alone all must agree who leads, how far the formation is in its trajectory, and how near each is to the leader;
a vehicle that is wrong about one of these pulls its neighbours off.

The model is Algorithm 1 of the paper (docs/law.md), made for a fleet whose links fail. A vehicle's priority coefficient (PrC)
is one more than the least of its neighbours; a leader has 1. So PrC counts hops to the nearest leader. It does not show that
a leader is alive: without one, PrC rises to n and stays, and n is also valid at the end of a chain. So each packet relays the
leader's beacon, whose stamp only the leader raises (`election/beacon.py`), and the leadership has a term (`leadership.py`).

The peers of a tick are sets, each a part of the one before:
- known: all whose packets were ever accepted, however old the last one is;
- present: heard in time, at 50 Hz or, the distant ones, at 5 Hz. They count for checks, roles and changes;
- flying: present in a cooperating phase;
- relays: flying, and once the formation has come together also in it: their beacons and PrC count;
- neighbours: relays heard at 50 Hz that the rule selects, by edges or by range: N_i of the paper;
- followed: neighbours that form or fly in formation: the law steers by these, with weights by their PrC.
Fresh peers are those heard at 50 Hz in time; the separation filter looks at all of them, in whatever phase they are.

What always holds:
- one packet of this vehicle is of one role and one term: a commanded role comes before everything that is received;
- the term never falls but to the one before, from a term without a leader that is alive, or by command;
- a beacon passed on never becomes younger, so it dies out within its largest age and one tick a hop;
- PrC is 1 for a leader alone, and a leader of an older term counts as n: a deposed leader attracts no vehicle;
- mission time steps back on the ground alone, or with a leader whose beacons agree for longer than one can be wrong.

Sources: the paper's section 4 (Algorithms 1 and 2); terms and claims as in Raft (Ongaro and Ousterhout 2014), without votes,
as a minority that can fly must not wait for a majority that it cannot hear.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from math import inf
from operator import attrgetter

from msgspec import Struct
from msgspec.structs import replace

from companion.core.consensus.law import next_prc
from companion.core.consensus.neighbours import NeighbourRule
from companion.core.consensus.peers import MAX_TURN_RAD_S, PeerState, PeerTable, neighbour_at
from companion.core.election.beacon import WAITED_S, BeaconMonitor, MissionClock
from companion.core.election.leadership import Leadership, Succession, refusal_of_lead
from companion.geometry.formations import heading_after
from companion.geometry.vectors import clamped
from companion.laws import Neighbour
from companion.types.autopilot import VehicleState
from companion.types.commands import EPOCHS_AHEAD, NUMBERS_AHEAD, Command, Lead
from companion.types.flight import COOPERATING, STREAMING, Flight, FlightPhase, HealthFlag, Role
from companion.types.formation import Heading, LeaderBeacon, Term
from companion.types.notices import Answer, Notice
from companion.types.peers import LostVehicle, PeerPacket, ReceivedPeerPacket

# Member lookup of an enum is slow, and every tick needs these.
LEADER, FOLLOWER, FORMATION = Role.LEADER, Role.FOLLOWER, FlightPhase.FORMATION
LEADER_AWAITED, LEADER_LOST = HealthFlag.LEADER_AWAITED, HealthFlag.LEADER_LOST
# For map(): before Python 3.12 each comprehension makes a function, which takes longer than few elements.
PHASE, PRC = attrgetter("phase"), attrgetter("prc")
EPOCHS_PER_S = 1.0  # changes of leader that may be missed in time
NONE: tuple[tuple[tuple[int, Answer], ...], tuple[Notice, ...]] = ((), ())  # no answers and no events
FORMING_S = 2.0  # so long a formation may take to come together


class LeadView(Struct, frozen=True, gc=False):
    """The own role and term, and what this vehicle knows of its leader.

    An armed vehicle without a position is a follower, whatever the fleet file or a command says: no peer could follow it.
    `beacon` is the one to pass on, None without a fresh leader. `heading` is that of the formation as peers report it, None
    where this vehicle decides it. `reference_s` is mission time, as far as this vehicle knows: how far the fleet is in the RFT.
    """

    role: Role
    term: Term
    beacon: LeaderBeacon | None
    beacon_age_s: float
    # LEADER_AWAITED: followers hold formation among themselves; LEADER_LOST: for too long
    leaderless: HealthFlag | None
    reference_s: float
    heading: Heading | None


class Neighbours(Struct, frozen=True, gc=False):
    """The neighbours that the law follows: their ids, and what the law knows of each, in the same order."""

    ids: tuple[int, ...] = ()
    states: tuple[Neighbour, ...] = ()

    @property
    def prcs(self) -> list[int]:
        """In the order of `ids`."""
        return [state.prc for state in self.states]


class PeerSets(Struct, frozen=True, gc=False):
    """Peers by id, from all that were ever heard to those that count most; the theory of the stage has the sets."""

    known: Mapping[int, PeerState] = {}  # the last packet of every peer, however old
    present: Mapping[int, PeerState] = {}  # the fresh ones, and the distant ones that are in time at 5 Hz
    fresh: Mapping[int, PeerState] = {}  # received at 50 Hz and in time: law and separation filter use these
    flying: tuple[PeerPacket, ...] = ()  # the present ones in a cooperating phase
    duplicate_id_s: float = -inf  # when a packet of a second agent with a known id last came
    lost: tuple[LostVehicle, ...] = ()  # those that fell silent, and may still be in the air
    in_doubt: tuple[int, ...] = ()  # those that send positions and velocities that contradict each other
    refused: tuple[int, ...] = ()  # those that for a while have sent nothing but what is refused, or not believed
    rejected: Mapping[str, int] = {}
    until_s: float = -inf  # until when they remain these, without a further packet

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


def _followed(ids: tuple[int, ...], packets: Sequence[PeerPacket], leads: bool) -> tuple[int, ...]:
    """Which of these neighbours the law uses: those that form or fly in formation. `packets` are in the same order.

    A vehicle in hold may not have been commanded to form: where it is says nothing about the formation. Only a leader in hold
    counts, where no other leads: the fleet waits with it. `leads`: this vehicle is leader.
    """
    if STREAMING.issuperset(map(PHASE, packets)):
        return ids
    led = leads or any(p.role is LEADER for p in packets if p.phase in STREAMING)
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
        law_values: int = 0,
    ) -> None:
        """`law_values`: so many vectors of its own a vehicle must publish, so that the law can use it."""
        self._own_id = own_id
        self._law_values = law_values
        self._n = n
        self._rule = rule
        self._leader = leader
        self._succession = succession
        self._clock = MissionClock()
        self._led_s = -inf  # when a leader of the own term was last known
        self._known_term: Term | None = None  # term in the last tick; None if no leader was known then
        self._last_known_s = -inf  # the last tick with a leader known in the same term as in the tick before
        self._formed_s: float | None = None  # since when this vehicle is in formation
        self._sets = PeerSets()  # as they were before the tick
        self.leadership = leadership
        self.peers = peers

    def receive(
        self, now_s: float, packets: Collection[ReceivedPeerPacket], distant: frozenset[int] = frozenset()
    ) -> None:
        """The first part of a tick: check and take the packets that are there before it.

        Nothing is judged by them before `step`. `distant` are the peers that are received at 5 Hz, of the last tick.
        """
        table = self.peers
        if distant or table.low_rate_s:
            table.set_low_rate_peers(now_s, distant)
        if packets:
            table.fold(packets, self._epochs_up_to(now_s))
        self._sets = self._peer_sets(now_s)

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        packets: Collection[ReceivedPeerPacket] = (),
        commands: Collection[Command] = (),
        refusal_to_lead: Notice | None = None,
        fit_to_lead: bool = False,
        checks: Collection[Command] = (),
    ) -> Consensus:
        """The second part: Algorithm 1 and the neighbour set. `packets` came since `receive`; `checks` are only answered.

        A commanded role comes first: one tick, its packet included, is of one role. `refusal_to_lead` is why this vehicle must
        not become leader, `fit_to_lead` that it flies in formation without a failsafe; both of the last tick.
        """
        leadership, sets, in_formation = self.leadership, self._sets, flight.in_formation
        answers, events = self._command_leads(now_s, commands, vehicle, flight, refusal_to_lead) if commands else NONE
        answers += self._check_leads(checks, vehicle, flight, refusal_to_lead) if checks else ()
        self._clock.on_ground = not vehicle.armed
        epochs_up_to = self._epochs_up_to(now_s)
        if packets:
            self.peers.fold(packets, epochs_up_to)
        if packets or now_s > sets.until_s:
            sets = self._peer_sets(now_s)
        fresh, present, flying = sets.fresh, sets.present, sets.flying
        changes = self._newer_terms(now_s, present.values(), epochs_up_to)
        relays = self._relays(now_s, flying, fresh, present, in_formation)
        ids = self._rule.select(vehicle.position_enu_m, relays, now_s)
        neighbours = []
        for i in ids:
            neighbours.append(fresh[i].packet)
        self._receive_beacons(now_s, neighbours, fresh)
        youngest, age_s = self._leader.youngest(now_s)
        settled = self._settle_term(now_s, in_formation, youngest, flying)
        leaderless, claimed = self._awaited(now_s, youngest is not None, neighbours, flying, fit_to_lead)
        has_place = vehicle.position_time_s > -inf or not vehicle.armed
        role, term = leadership.role if has_place else FOLLOWER, leadership.term
        followed = _followed(ids, neighbours, role is LEADER) if in_formation else ids
        if self._law_values:  # a law that is given fewer values than it expects would fail
            followed = tuple([i for i in followed if len(fresh[i].packet.law_values) == self._law_values])
        states = self._states(now_s, map(fresh.__getitem__, followed), term)
        heading = self._received_heading(role, in_formation, youngest, age_s)
        beacon, beacon_age_s, reference_s = self._beacon(now_s, role, in_formation, youngest, age_s)
        return Consensus(
            prc=next_prc(role is LEADER, map(PRC, states), self._n),
            lead=LeadView(
                role=role,
                term=term,
                beacon=beacon,
                beacon_age_s=beacon_age_s,
                leaderless=leaderless if beacon is None else None,
                reference_s=reference_s,
                heading=heading,
            ),
            neighbours=Neighbours(followed, states),
            peers=sets,
            answers=answers,
            events=events + changes + settled + claimed,
        )

    def _receive_beacons(self, now_s: float, neighbours: Iterable[PeerPacket], fresh: Mapping[int, PeerState]) -> None:
        """Those that neighbours pass on, and what the fresh leaders say themselves.

        The own beacon comes back from before a handover or a restart.
        """
        passed_on, said = [], []
        for packet in neighbours:
            beacon = packet.leader.beacon
            if beacon is not None and beacon.leader_id != self._own_id:
                passed_on.append(beacon)
        for peer in fresh.values():
            if peer.packet.role is LEADER and (beacon := peer.packet.leader.beacon) is not None:
                said.append((beacon, now_s - peer.measured_s))
        self._leader.receive(now_s, passed_on, self.leadership.term, said)

    def _peer_sets(self, now_s: float) -> PeerSets:
        table = self.peers
        fresh, present = table.in_time(now_s)
        flying = []
        for peer in present.values():
            if peer.packet.phase in COOPERATING:
                flying.append(peer.packet)
        return PeerSets(
            known=dict(table.known),
            present=present,
            fresh=fresh,
            flying=tuple(flying),
            duplicate_id_s=table.duplicate_id_s,
            lost=table.lost(now_s) if len(present) < len(table.known) else (),
            in_doubt=table.in_doubt(now_s) if len(present) < len(table.known) else (),
            refused=table.refused(now_s) if table.disbelief.sums else (),
            rejected=table.rejected,
            until_s=table.until_s(fresh, present),
        )

    def _newer_terms(self, now_s: float, peers: Iterable[PeerState], epochs_up_to: int) -> tuple[Notice, ...]:
        """The events of the changes of the lead that these peers report, and that the named leader has stated itself.

        With identities a follower's hearsay of a newer term counts for nothing: any admitted vehicle could depose the leader.
        """
        events: tuple[Notice, ...] = ()
        for peer in peers:
            # A command may just have lowered `epochs_up_to`.
            if peer.proven and self.leadership.term < peer.term and peer.term[0] <= epochs_up_to:
                events += self.leadership.receive(now_s, [peer.packet.leader.beacon])
        return events

    def _epochs_up_to(self, now_s: float) -> int:
        """The largest epoch to accept: the changes that this vehicle may have missed since it last knew its leader."""
        missed = EPOCHS_AHEAD + EPOCHS_PER_S * (now_s - self._led_s)
        return self.leadership.term[0] + (int(missed) if missed < NUMBERS_AHEAD else NUMBERS_AHEAD)

    def _settle_term(
        self, now_s: float, in_formation: bool, youngest: LeaderBeacon | None, flying: Iterable[PeerPacket]
    ) -> tuple[Notice, ...]:
        """Return to the term before where no leader of the new one is alive. The event of a change of role.

        Any vehicle shows that the leader is alive: a vehicle out of formation may have no neighbours, and over many hops a
        beacon needs longer than a packet that this vehicle receives itself.
        """
        leadership = self.leadership
        if leadership.role is LEADER:
            led = in_formation  # a leader on the ground may have restarted, and missed changes
        else:
            led = youngest is not None and (youngest.epoch, -youngest.claim) == leadership.term
        if led:
            self._led_s = now_s
        if leadership.unconfirmed is None:
            return ()
        return leadership.settle(now_s, [p.leader.beacon for p in flying if p.leader.beacon is not None])

    def _states(self, now_s: float, peers: Iterable[PeerState], term: Term) -> tuple[Neighbour, ...]:
        """What the law knows of each. A leader of an older term has not received the change yet: its PrC is n."""
        states = []
        for peer in peers:
            is_deposed = peer.packet.leader.prc == 1 and peer.term < term
            states.append(neighbour_at(peer, now_s, self._n if is_deposed else peer.packet.leader.prc))
        return tuple(states)

    def _command_leads(
        self,
        now_s: float,
        commands: Collection[Command],
        vehicle: VehicleState,
        flight: Flight,
        refusal_to_lead: Notice | None,
    ) -> tuple[tuple[tuple[int, Answer], ...], tuple[Notice, ...]]:
        """The answers by command number, and the events of a change of role."""
        answers: list[tuple[int, Answer]] = []
        events: list[Notice] = []
        for command in commands:
            if isinstance(command.content, Lead):
                lowers = command.content.epoch < self.leadership.term[0]
                answer, changes = self._command_lead(command.content, vehicle, flight, refusal_to_lead)
                if lowers and answer.accepted:
                    self._led_s = now_s  # peers in the epoch left are not believed
                answers.append((command.number, answer))
                events += changes
        return tuple(answers), tuple(events)

    def _check_leads(
        self, checks: Collection[Command], vehicle: VehicleState, flight: Flight, refusal_to_lead: Notice | None
    ) -> tuple[tuple[int, Answer], ...]:
        """The answers to checks by number."""
        answers = []
        for check in checks:
            if isinstance(lead := check.content, Lead):
                refusal = self._refusal_of_lead(lead, vehicle, flight, refusal_to_lead)
                answers.append((check.number, Answer(False, refusal) if refusal else self.leadership.judge(lead)))
        return tuple(answers)

    def _command_lead(
        self, lead: Lead, vehicle: VehicleState, flight: Flight, refusal_to_lead: Notice | None
    ) -> tuple[Answer, tuple[Notice, ...]]:
        refusal = self._refusal_of_lead(lead, vehicle, flight, refusal_to_lead)
        return (Answer(False, refusal), ()) if refusal else self.leadership.command(lead)

    def _refusal_of_lead(
        self, lead: Lead, vehicle: VehicleState, flight: Flight, refusal_to_lead: Notice | None
    ) -> Notice | None:
        refusal = refusal_of_lead(flight, vehicle)
        if not refusal and refusal_to_lead and self._own_id in lead.leaders:
            refusal = refusal_to_lead.about("lead")
        return refusal

    def _relays(
        self,
        now_s: float,
        flying: Sequence[PeerPacket],
        fresh: Mapping[int, PeerState],
        present: Mapping[int, PeerState],
        in_formation: bool,
    ) -> Mapping[int, PeerState]:
        """The fresh peers whose beacons are passed on. Once a formation has come together, only vehicles in it are used.

        A leader out of formation is used where none leads in it: it left by command, and the fleet waits with it.
        """
        relays = flying
        if not in_formation:
            self._formed_s = None
        elif self._formed_s is None:
            self._formed_s = now_s
        elif now_s - self._formed_s > FORMING_S:
            formed = [p for p in flying if p.phase is FORMATION]
            if len(formed) < len(flying):
                led = self.leadership.role is LEADER or LEADER in [p.role for p in formed]
                relays = [p for p in flying if p.phase is FORMATION or (p.role is LEADER and not led)]
        if len(relays) == len(fresh) and present is fresh:  # the usual case: all of them
            return fresh
        return {p.sender.vehicle_id: fresh[p.sender.vehicle_id] for p in relays if p.sender.vehicle_id in fresh}

    def _awaited(
        self,
        now_s: float,
        hears_leader: bool,
        neighbours: list[PeerPacket],
        flying: Sequence[PeerPacket],
        fit_to_lead: bool,
    ) -> tuple[HealthFlag | None, tuple[Notice, ...]]:
        """Become leader where there is none and it is this vehicle's turn. Returns the flag without a leader, and events.

        A vehicle that has lost all its neighbours may be the one that is lost: it does not wait for its turn. No successor
        takes over while it receives a leader that no neighbour passes on, nor without a known mission time.
        """
        leadership = self.leadership
        led, term = hears_leader or leadership.role is LEADER, leadership.term
        if led and term == self._known_term:
            self._last_known_s = now_s
            return None, ()
        self._known_term = term if led else None
        with_neighbours = FORMATION in [packet.phase for packet in neighbours]
        if not self._succession.awaits(now_s, term, led, with_neighbours, self._last_known_s):
            return LEADER_LOST, ()
        may_take = not led and fit_to_lead and self._clock.has_run
        if may_take and (rank := self._succession.rank_in_turn(now_s)) and not self._leads_in(flying):
            return LEADER_AWAITED, leadership.claim(rank)
        return LEADER_AWAITED, ()

    def _leads_in(self, flying: Iterable[PeerPacket]) -> bool:
        """Whether a leader of this term or a newer one flies; a leader of an older term does not know the change yet."""
        term = self.leadership.term
        return any(p.role is LEADER and p.leader.beacon is not None and p.leader.beacon.term >= term for p in flying)

    def _received_heading(
        self, role: Role, in_formation: bool, youngest: LeaderBeacon | None, age_s: float
    ) -> Heading | None:
        """Heading in the beacon, extrapolated to now. A leader uses that of one already in the RFT, or of the smallest id."""
        if youngest is None or youngest.leader_id == self._own_id:
            return None
        if role is LEADER:
            of_own_term = youngest.term == self.leadership.term and youngest.reference_s > 0.0
            if not of_own_term or (in_formation and youngest.leader_id > self._own_id):
                return None
        heading = heading_after(youngest.heading, age_s + WAITED_S)
        most = MAX_TURN_RAD_S  # the limit of what peers accept: a beacon passed on must not get this vehicle rejected
        if -most <= heading.rate_rad_s <= most:
            return heading
        return replace(heading, rate_rad_s=clamped(heading.rate_rad_s, most))

    def _beacon(
        self, now_s: float, role: Role, in_formation: bool, youngest: LeaderBeacon | None, age_s: float
    ) -> tuple[LeaderBeacon | None, float, float]:
        """The beacon to pass on, its age, and mission time; `youngest` is the youngest received beacon."""
        of_other = youngest if youngest is not None and youngest.leader_id != self._own_id else None
        if role is LEADER:
            lead, stamp = self.leadership, int(now_s * 1000.0)
            if in_formation and of_other and (of_other.term != lead.term or of_other.leader_id > self._own_id):
                of_other = None
            reference_s = self._clock.lead(now_s, in_formation, of_other, age_s)
            own = LeaderBeacon(self._own_id, lead.epoch, stamp, reference_s if in_formation else 0.0, lead.claim_rank)
            self._leader.receive(now_s, [own], lead.term)  # remembered in case this vehicle becomes a follower
            return own, 0.0, reference_s
        reference_s = self._clock.update(now_s, in_formation, of_other, age_s)
        if youngest is None:
            return None, age_s, reference_s
        reported_s = reference_s if self._clock.runs else 0.0
        if not self._clock.runs and of_other and of_other.reference_s > 0.0:  # not believed yet: passed on unchanged
            reported_s = of_other.reference_s + age_s + WAITED_S
        return (
            LeaderBeacon(youngest.leader_id, youngest.epoch, youngest.stamp, reported_s, youngest.claim),
            age_s,
            reference_s,
        )
