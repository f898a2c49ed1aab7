"""Changes of formation and reference: by command, passed on by leaders, or proposed after a vehicle has left.

Each vehicle checks every change itself.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from math import inf

from msgspec import Struct

from companion.core.consensus.law import formation_state
from companion.core.consensus.stage import Consensus
from companion.core.formation.gaps import GapFilling, Proposal
from companion.core.formation.limits import Tracks, members, refusal_of_tracks, tracks_about
from companion.core.formation.slots import SlotPlan
from companion.core.paced import BEING_CHECKED, STEPS_PER_TICK, PacedChecks, Pending
from companion.core.reference.plan import ReferencePlan
from companion.geometry.curves import rest_to_rest
from companion.geometry.vectors import plus
from companion.types.autopilot import VehicleState
from companion.types.commands import Command, Content, ReferenceChange
from companion.types.flight import Flight, FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, Term
from companion.types.notices import Answer, Code, Judged, Notice, refuse
from companion.types.peers import PeerPacket
from companion.types.steps import Steps
from companion.types.values import Vector3

LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION  # member lookup of an enum is slow
QUEUED = 3  # commands with content that wait for their check; more of them are refused
HEARD_PERIOD_S = 0.1  # shortest time between two checks of leaders' changes
TRACK_SAMPLES = 40  # a formation change is checked at this many points of each track


class Changed(Struct, frozen=True, gc=False):
    """The answers to commands, by command number, and what happened without a command."""

    answers: tuple[tuple[int, Answer], ...] = ()
    events: tuple[Notice, ...] = ()


NOTHING_CHANGED = Changed()


class Situation(Struct, frozen=True, gc=False):
    """What changes are judged by in this tick. `slot` is the one flown in the last tick."""

    now_s: float
    vehicle: VehicleState
    flight: Flight
    consensus: Consensus
    slot: FlownSlot

    @property
    def fleet_enu_m(self) -> Vector3:
        """r of the fleet, derived from this vehicle's own position and slot."""
        vehicle = self.vehicle
        return formation_state(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self.slot).position_enu_m


class Changes:
    """Applies changes to the slot plan and the reference plan of one vehicle."""

    def __init__(
        self, own_id: int, slots: SlotPlan, references: ReferencePlan | None, gap_filling: GapFilling | None
    ) -> None:
        """`gap_filling` is None where the gap of a vehicle that left is kept."""
        self._own_id = own_id
        self._slots = slots
        self._references = references
        self._gap_filling = gap_filling
        self._refused_number: int | None = None  # number of the leader's change that was refused last; reported once
        self.checks = PacedChecks(STEPS_PER_TICK)
        self._queue: list[Command] = []  # commands that wait for their check, one each tick
        self._check: Command | None = None  # that is being judged, and is not carried out
        self._heard: tuple[int, FormationChange] | None = None  # the leader and its change that is being checked
        self._last_heard_id = 0  # the leader whose change was judged last
        self._next_heard_s = -inf
        self._proposal: Proposal | None = None  # that is being checked
        # Nothing is under way: without a command or a change of a leader no step is needed.
        self.is_idle = gap_filling is None

    def step(self, now: Situation, commands: Collection[Command], checks: Collection[Command] = ()) -> Changed:
        """Apply commands first, then changes of leaders, then this vehicle's own proposal. Last come checks of commands.

        The answer to a command may come ticks later.
        """
        self.checks.begin_tick()
        answers = []
        for command in commands:
            if not isinstance(command.content, FormationChange | ReferenceChange):
                continue
            if len(self._queue) < QUEUED:
                self._queue.append(command)
            else:
                text = f"{command.name}: other changes are being checked; give it again"
                answers.append((command.number, refuse(Code.CHANGE_IN_PROGRESS, text)))
        if self._queue:
            answer = self._judge(self._queue[0].content, now).carried_out()
            if answer is not BEING_CHECKED:
                answers.append((self._queue.pop(0).number, answer))
        events = self._adopt(now)
        if self._gap_filling:
            events += self._fill_gap(self._gap_filling, now)
        answers += self._answer_checks(now, checks)
        if not self._gap_filling:
            waits = self._queue or self._check or self._heard is not None
            self.is_idle = not waits and self.checks.is_idle
        return Changed(tuple(answers), events)

    def _answer_checks(self, now: Situation, checks: Collection[Command]) -> list[tuple[int, Answer]]:
        """Of checks with content one is judged at a time, with what is left of the tick: they delay no change.

        A newer one takes its place, so that none has to wait for one that takes long.
        """
        answers = []
        for check in checks:
            if not isinstance(check.content, FormationChange | ReferenceChange):
                continue
            if self._check:
                text = f"{self._check.name}: a newer check came before this one was done"
                answers.append((self._check.number, refuse(Code.CHANGE_IN_PROGRESS, text)))
            self._check = check
        if self._check:
            answer = self._judge(self._check.content, now).answer
            if answer is not BEING_CHECKED:
                answers.append((self._check.number, answer))
                self._check = None
        return answers

    def _judge(self, content: Content | None, now: Situation) -> Judged:
        if isinstance(content, FormationChange):
            return self._judge_formation(content, now, is_command=True)
        assert isinstance(content, ReferenceChange)
        return self._judge_reference(content, now)

    def _judge_formation(self, change: FormationChange, now: Situation, is_command: bool = False) -> Judged:
        def check(airspace: Steps[Notice | None]) -> Notice | Pending | None:
            key = (change, flight.on_ground, flown_slots, self._references and self._references.flown_count)
            return self.checks.ask(key, lambda: self._expensive_refusal(change, airspace, consensus))

        flight, consensus = now.flight, now.consensus
        flown_slots = tuple(sorted(self._slots.slots_enu_m.items()))
        rft_enu_m = self._rft_enu_m(now)
        if flight.on_ground:
            return self._slots.judge_on_ground(change, consensus.peers.flying, rft_enu_m, is_command, check)
        in_formation = [other for other in consensus.peers.flying if other.phase is FORMATION]
        alone = flight.phase is not FORMATION
        others = in_formation if alone else ()
        verdict = self._slots.judge(change, consensus.lead.reference_s, others, rft_enu_m, is_command, check)
        if verdict.answer.notice.code is not Code.FORMATION_ACCEPTED or alone:
            return verdict
        tracks = self._tracks_of_change(change, consensus, now.fleet_enu_m)
        if refusal := self._in_the_way(tracks, consensus):
            return Judged(Answer(False, refusal.about("formation")))
        return verdict

    def _tracks_of_change(self, change: FormationChange, consensus: Consensus, fleet_enu_m: Vector3) -> Tracks:
        """Tracks of the vehicles in formation while they change it, about the RFT where this vehicle knows it."""
        before, after, references = self._slots.slots_enu_m, dict(change.slots_enu_m), self._references
        ids = [i for i in members(self._own_id, consensus.peers.flying) if i not in change.absent]
        tracks: dict[int, list[Vector3]] = {i: [] for i in ids}
        for k in range(TRACK_SAMPLES + 1):
            elapsed_s = change.lasts_s * k / TRACK_SAMPLES
            r = references.at(change.begins_s + elapsed_s).position_enu_m if references else fleet_enu_m
            for i, track in tracks.items():
                track.append(plus(r, rest_to_rest(before[i], after[i], elapsed_s, change.lasts_s)[0]))
        return tracks

    def _in_the_way(self, tracks: Tracks, consensus: Consensus) -> Notice | None:
        """The refusal by a vehicle that stays; slots that turn with the course are left to the separation filter."""
        limits = self._slots.limits
        return None if limits.slots_turn else refusal_of_tracks(tracks, consensus.peers.packets, limits.separation_m)

    def _expensive_refusal(
        self, change: FormationChange, airspace: Steps[Notice | None], consensus: Consensus
    ) -> Steps[Notice | None]:
        """Airspace, and whether the law can fly the slots with the reference. What others fly already is adopted."""
        if refusal := (yield from airspace):
            return refusal
        flown = any(other.slot.formation == change.number for other in consensus.peers.flying)
        if self._references is None or flown:
            return None
        yield
        reason = yield from self._references.refusal_of_slots(dict(change.slots_enu_m))
        return None if reason is None else Notice(Code.SLOTS_NOT_FOLLOWED, reason)

    def _judge_reference(self, change: ReferenceChange, now: Situation) -> Judged:
        if self._references is None:
            text = "reference: this vehicle may not lead and has no reference"
            return Judged(refuse(Code.REFERENCE_NOT_ALLOWED, text))
        flight, consensus, slots_enu_m = now.flight, now.consensus, self._slots.slots_enu_m
        verdict, track_enu_m = self._references.judge(
            change,
            consensus.lead.reference_s,
            slots_enu_m,
            consensus.peers.flying,
            now.fleet_enu_m,
            flight.in_formation,
            self.checks,
        )
        if not track_enu_m or flight.phase is not FORMATION:
            return verdict
        tracks = tracks_about(track_enu_m, slots_enu_m, members(self._own_id, consensus.peers.flying))
        if refusal := self._in_the_way(tracks, consensus):
            return Judged(Answer(False, refusal.about("reference")))
        return verdict

    def _rft_enu_m(self, now: Situation) -> list[Vector3]:
        """Positions of the RFT as far as this vehicle knows them: all of its reference plan, or where the fleet is now."""
        if self._references:
            return self._references.positions_enu_m(now.consensus.lead.reference_s)
        return [now.fleet_enu_m] if now.flight.phase is FORMATION else []

    def _adopt(self, now: Situation) -> tuple[Notice, ...]:
        """Apply the changes of leaders like commands; of two different ones, that of the smallest leader id.

        One change is judged at a time, and the leaders take turns: a leader may send another change in every packet.
        """
        changes = passed_on(now.consensus.peers.flying, now.consensus.lead.term, now.flight.on_ground)
        if not changes:
            self._heard = None
            return ()
        first_id = self._first_leader(now)
        of_first = [one for one in changes if one[0] == first_id]
        lacked = [one for one in of_first or changes if self._slots.lacks(one[1], over_own=one[0] == first_id)]
        heard = self._heard if self._heard in lacked else None
        if heard is None:
            if not lacked or now.now_s < self._next_heard_s:
                self._heard = None
                return ()
            heard = next((one for one in lacked if one[0] > self._last_heard_id), lacked[0])
            self._last_heard_id, self._next_heard_s = heard[0], now.now_s + HEARD_PERIOD_S
        vehicle_id, change = heard
        answer = self._judge_formation(change, now).carried_out()
        self._heard = heard if answer is BEING_CHECKED else None
        if answer is BEING_CHECKED:
            return ()
        is_new = answer.accepted or change.number != self._refused_number
        self._refused_number = None if answer.accepted else change.number
        return (answer.notice.about(f"passed on by vehicle {vehicle_id}"),) if is_new else ()

    def _fill_gap(self, gap_filling: GapFilling, now: Situation) -> tuple[Notice, ...]:
        """The first leader proposes a formation without the vehicle that left; all vehicles check it."""
        consensus = now.consensus
        if not now.vehicle.armed:
            gap_filling.restart()
        gap_filling.update(now.now_s, consensus.peers.flying)
        slots, references = self._slots, self._references
        is_first = self._first_leader(now) == self._own_id
        if references is None or not is_first or not slots.is_settled(consensus.lead.reference_s):
            self._proposal = None
            return ()
        proposal = self._proposal or gap_filling.propose(
            now.now_s,
            slots.slots_enu_m,
            slots.flown.waiting,
            consensus.peers.known,
            consensus.lead.reference_s,
            lambda reference_s: references.at(reference_s).position_enu_m,
        )
        if proposal.change is None:
            return proposal.events
        answer = self._judge_formation(proposal.change, now).carried_out()
        self._proposal = Proposal(proposal.gone_id, proposal.change) if answer is BEING_CHECKED else None
        if answer is BEING_CHECKED:
            return proposal.events
        accepted, notice = answer
        if accepted:
            return (*proposal.events, notice.about(f"closes the gap of vehicle {proposal.gone_id}"))
        return proposal.events + gap_filling.keep_gap(proposal.gone_id, notice.text)

    def _first_leader(self, now: Situation) -> int | None:
        leads = now.consensus.lead.role is LEADER and now.flight.phase is FORMATION
        return first_leader(now.consensus.peers.flying, self._own_id if leads else None)


def first_leader(flying: Iterable[PeerPacket], own_id: int | None) -> int | None:
    """The smallest id of all leaders in formation; None without one. `own_id`: this vehicle, where it is one of them."""
    ids = [packet.sender.vehicle_id for packet in flying if _leads(packet)]
    return min(ids if own_id is None else [*ids, own_id], default=None)


def passed_on(flying: Iterable[PeerPacket], term: Term, on_ground: bool) -> list[tuple[int, FormationChange]]:
    """(leader, change) from the leaders of this term, the smallest id first.

    A vehicle `on_ground` adopts only the formation that the leader flies already, not one that is still to begin.
    """
    changes = [
        (packet.sender.vehicle_id, packet.change)
        for packet in flying
        if packet.change and _leads(packet) and packet.leader.beacon and packet.leader.beacon.term == term
        if not on_ground or packet.change.number == packet.slot.formation
    ]
    changes.sort(key=lambda change: change[0])
    return changes


def _leads(packet: PeerPacket) -> bool:
    return packet.role is LEADER and packet.phase is FORMATION
