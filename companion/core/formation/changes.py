"""Changes of formation and reference: by command, passed on by leaders, or proposed after a vehicle has left.

Each vehicle checks every change itself.
"""

from __future__ import annotations

from collections.abc import Collection

from msgspec import Struct

from companion.core.command.phase import Flight
from companion.core.consensus.law import formation_state
from companion.core.consensus.neighbourhood import Consensus
from companion.core.formation.change_gossip import first_leader, passed_on
from companion.core.formation.gap_filling import GapFilling
from companion.core.formation.obstructions import Tracks, members, refusal_of_tracks, tracks_about
from companion.core.formation.slots import SlotPlan
from companion.core.reference.plan import ReferencePlan
from companion.geometry.curves import rest_to_rest
from companion.geometry.vectors import plus
from companion.types.autopilot import VehicleState
from companion.types.commands import Command, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Answer, Code, Notice, refused
from companion.types.vectors import Vector3

TRACK_SAMPLES = 40  # of a formation change


class Changed(Struct, frozen=True, gc=False):
    """The answers to commands, by command number, and what happened without a command."""

    answers: tuple[tuple[int, Answer], ...] = ()
    events: tuple[Notice, ...] = ()


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
        self._refused_number: int | None = None  # of the last refused change of a leader, which is reported once

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        slot: FlownSlot,
        commands: Collection[Command],
    ) -> Changed:
        """Apply commands first, then changes of leaders, then this vehicle's own proposal.

        `slot` is the one flown in the last tick.
        """
        answers = []
        for command in commands:
            match command.content:
                case FormationChange() as change:
                    answer = self._change_formation(change, vehicle, flight, consensus, slot, is_command=True)
                    answers.append((command.number, answer))
                case ReferenceChange() as change:
                    answers.append((command.number, self._change_reference(change, vehicle, flight, consensus, slot)))
        events = self._adopt(vehicle, flight, consensus, slot)
        if self._gap_filling:
            events += self._fill_gap(self._gap_filling, now_s, vehicle, flight, consensus, slot)
        return Changed(tuple(answers), events)

    def _change_formation(
        self,
        change: FormationChange,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        slot: FlownSlot,
        is_command: bool = False,
    ) -> Answer:
        if reason := self._not_followed(change, consensus):
            return refused(Code.SLOTS_NOT_FOLLOWED, f"formation: {reason}")
        rft_enu_m = self._rft_enu_m(vehicle, flight, consensus, slot)
        if flight.on_ground:
            return self._slots.change_on_ground(change, consensus.flying, rft_enu_m, is_command)
        in_formation = [other for other in consensus.flying if other.phase is FlightPhase.FORMATION]
        alone = flight.phase is not FlightPhase.FORMATION
        others = in_formation if alone else ()
        answer = self._slots.change(change, consensus.reference_s, others, rft_enu_m, is_command)
        if answer.notice.code is not Code.FORMATION_ACCEPTED or alone:
            return answer
        tracks = self._tracks_of_change(change, consensus, _fleet_enu_m(vehicle, slot))
        if refusal := self._in_the_way(tracks, consensus):
            self._slots.withdraw()
            return Answer(False, refusal.about("formation"))
        return answer

    def _tracks_of_change(self, change: FormationChange, consensus: Consensus, fleet_enu_m: Vector3) -> Tracks:
        """Tracks of the vehicles in formation while they change it, about the RFT where this vehicle knows it."""
        before, after, references = self._slots.slots_enu_m, dict(change.slots_enu_m), self._references
        ids = [i for i in members(self._own_id, consensus.flying) if i not in change.absent]
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
        return None if limits.slots_turn else refusal_of_tracks(tracks, consensus.peers, limits.separation_m)

    def _not_followed(self, change: FormationChange, consensus: Consensus) -> str | None:
        """Why the law cannot fly a new formation with the reference of this vehicle. What others fly already is adopted."""
        flown = any(other.slot.formation == change.number for other in consensus.flying)
        complete = {vehicle_id for vehicle_id, _ in change.slots_enu_m} == self._slots.slots_enu_m.keys()
        if self._references is None or flown or not complete or not self._slots.lacks(change, over_own=True):
            return None
        return self._references.refusal_of_slots(dict(change.slots_enu_m))

    def _change_reference(
        self, change: ReferenceChange, vehicle: VehicleState, flight: Flight, consensus: Consensus, slot: FlownSlot
    ) -> Answer:
        if self._references is None:
            text = "reference: this vehicle may not lead and has no reference"
            return refused(Code.REFERENCE_NOT_ALLOWED, text)
        fleet_enu_m, slots_enu_m = _fleet_enu_m(vehicle, slot), self._slots.slots_enu_m
        answer = self._references.change(
            change, consensus.reference_s, slots_enu_m, consensus.flying, fleet_enu_m, flight.in_formation
        )
        if answer.notice.code is not Code.REFERENCE_ACCEPTED or flight.phase is not FlightPhase.FORMATION:
            return answer
        if not (track := self._references.waiting_track_enu_m(slots_enu_m)):
            return answer
        tracks = tracks_about(track, slots_enu_m, members(self._own_id, consensus.flying))
        if refusal := self._in_the_way(tracks, consensus):
            self._references.withdraw()
            return Answer(False, refusal.about("reference"))
        return answer

    def _rft_enu_m(self, vehicle: VehicleState, flight: Flight, consensus: Consensus, slot: FlownSlot) -> list[Vector3]:
        """Positions of the RFT as far as this vehicle knows them: all of its reference plan, or where the fleet is now."""
        if self._references:
            return self._references.positions_enu_m(consensus.reference_s)
        return [_fleet_enu_m(vehicle, slot)] if flight.phase is FlightPhase.FORMATION else []

    def _adopt(
        self, vehicle: VehicleState, flight: Flight, consensus: Consensus, slot: FlownSlot
    ) -> tuple[Notice, ...]:
        """Apply the changes of leaders like commands; of two different ones, that of the smallest leader id."""
        changes = passed_on(consensus.flying, consensus.term, flight.on_ground)
        if not changes:
            return ()
        events = []
        first_id = self._first_leader(flight, consensus)
        of_first = [(vehicle_id, change) for vehicle_id, change in changes if vehicle_id == first_id]
        for vehicle_id, change in of_first or changes:
            if not self._slots.lacks(change, over_own=vehicle_id == first_id):
                continue
            accepted, notice = self._change_formation(change, vehicle, flight, consensus, slot)
            if accepted or change.number != self._refused_number:
                events.append(notice.about(f"passed on by vehicle {vehicle_id}"))
            self._refused_number = None if accepted else change.number
        return tuple(events)

    def _fill_gap(
        self,
        gap_filling: GapFilling,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        slot: FlownSlot,
    ) -> tuple[Notice, ...]:
        """The first leader proposes a formation without the vehicle that left; all vehicles check it."""
        if not vehicle.armed:
            gap_filling.restart()
        gap_filling.update(now_s, consensus.flying)
        slots, references = self._slots, self._references
        is_first = self._first_leader(flight, consensus) == self._own_id
        if references is None or not is_first or not slots.is_settled(consensus.reference_s):
            return ()
        proposal = gap_filling.propose(
            now_s,
            slots.slots_enu_m,
            slots.flown.waiting,
            consensus.newest,
            consensus.reference_s,
            lambda reference_s: references.at(reference_s).position_enu_m,
        )
        if proposal.change is None:
            return proposal.events
        accepted, notice = self._change_formation(proposal.change, vehicle, flight, consensus, slot)
        if accepted:
            return (*proposal.events, notice.about(f"closes the gap of vehicle {proposal.gone_id}"))
        return proposal.events + gap_filling.keep_gap(proposal.gone_id, notice.text)

    def _first_leader(self, flight: Flight, consensus: Consensus) -> int | None:
        leads = consensus.role is Role.LEADER and flight.phase is FlightPhase.FORMATION
        return first_leader(consensus.flying, self._own_id if leads else None)


def _fleet_enu_m(vehicle: VehicleState, slot: FlownSlot) -> Vector3:
    """r of the fleet, derived from this vehicle's own position and slot."""
    return formation_state(vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot).position_enu_m
