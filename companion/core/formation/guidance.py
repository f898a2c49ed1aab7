"""Guidance: the slot of this tick turned to the heading, R of a leader, and the path into the slot."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from math import dist
from operator import attrgetter

from msgspec import Struct

from companion.core.consensus.law import formation_state
from companion.core.consensus.stage import Consensus
from companion.core.formation.changes import NOTHING_CHANGED, Changes, Situation
from companion.core.formation.entry import FormationEntry
from companion.core.formation.gaps import GapFilling
from companion.core.formation.paths import Entering
from companion.core.formation.slots import SlotPlan
from companion.core.reference.heading import CourseHeading
from companion.core.reference.plan import ReferencePlan
from companion.geometry.formations import turned_slot
from companion.types.autopilot import VehicleState
from companion.types.commands import Command, CommandName, Described
from companion.types.flight import RULES, STREAMING, Flight, FlightPhase, PhaseChange, PhaseRequest, Role
from companion.types.formation import EAST, FlownSlot, FormationChange, FormationState, Heading, HeldReference
from companion.types.notices import Answer, Code, Notice, Refused
from companion.types.peers import ReceivedTarget
from companion.types.values import ZERO3

# Member lookup of an enum is slow, and every tick needs these.
LEADER, ENGAGE, FORMATION = Role.LEADER, FlightPhase.ENGAGE, FlightPhase.FORMATION
MAY_FORM = RULES[CommandName.FORM].allowed
CHANGE = attrgetter("change")  # for map(), as in consensus/stage.py
MAX_OFF_FLEET_M = 30.0  # more than a fleet lags behind a fast RFT; farther away it is another RFT
NONE_REJECTED: Mapping[str, int] = {}


class Guidance(Struct, frozen=True, gc=False):
    """What this vehicle flies in this tick. `slot` is turned to `heading`; `plan_slot` is in the formation's own frame.

    `reference` is R of a leader, None for a follower. `refusal_to_lead` is why this vehicle must not become leader. On the
    command form, `refusal_to_enter` is why there is no path to the slot, and `warning_to_enter` names a path that it crosses.
    """

    slot: FlownSlot = FlownSlot(ZERO3)
    plan_slot: FlownSlot = FlownSlot(ZERO3)
    heading: Heading = EAST
    published_heading: Heading = EAST
    reference: FormationState | None = None
    held_reference: HeldReference | None = None  # None where this vehicle may not lead
    described: Described | None = None  # the reference flown
    target_age_s: float | None = None
    refusal_to_lead: Notice | None = None
    refusal_to_enter: Notice | None = None
    warning_to_enter: Notice | None = None
    offered: FormationChange | None = None  # what a leader passes on to its peers
    rejected: Mapping[str, int] = NONE_REJECTED
    answers: tuple[tuple[int, Answer], ...] = ()
    requests: tuple[PhaseRequest, ...] = ()
    events: tuple[Notice, ...] = ()


class GuidanceStage:
    """Owns the slot plan, the reference plan, the heading and the entry.

    A vehicle that may not lead has no reference plan; slots that keep their directions in ENU have no heading.
    """

    def __init__(
        self,
        own_id: int,
        slots: SlotPlan,
        heading: CourseHeading | None,
        references: ReferencePlan | None,
        entry: FormationEntry,
        gap_filling: GapFilling | None,
    ) -> None:
        self._slots = slots
        self._heading = heading
        self.references = references
        self._entry = entry
        self.changes = Changes(own_id, slots, references, gap_filling)
        self._slot = slots.flown
        self._formed: list[int] = []  # the peers in formation

    def step(
        self,
        now_s: float,
        vehicle: VehicleState,
        flight: Flight,
        consensus: Consensus,
        commands: Collection[Command],
        targets: Iterable[ReceivedTarget],
        checks: Collection[Command] = (),
    ) -> Guidance:
        """Slot, heading and R of this tick, after the changes that commands and peers bring. `checks` bring none."""
        slots, heading, references = self._slots, self._heading, self.references
        events = () if vehicle.armed else self._restart()
        changed = NOTHING_CHANGED
        if commands or any(map(CHANGE, consensus.peers.flying)) or not self.changes.is_idle or checks:
            changed = self.changes.step(Situation(now_s, vehicle, flight, consensus, self._slot), commands, checks)
            events += changed.events
        reference_s, leads = consensus.lead.reference_s, consensus.lead.role is LEADER
        follows = flight.phase is FORMATION and not leads
        planned, reference, refusal_to_lead = None, None, None
        if references:
            events += references.update(now_s, reference_s, slots.slots_enu_m, consensus.peers.flying, targets)
            planned = references.at(reference_s)
            reference = self._entry.reference(now_s, vehicle, flight, consensus, planned, self._slot)
            refusal_to_lead = self._refusal_to_lead(now_s, vehicle, references, planned, follows)
        rft = planned if leads else None
        formed = [peer.sender.vehicle_id for peer in consensus.peers.flying if peer.phase is FORMATION]
        if formed != self._formed:
            self._formed = formed
            self._entry.update(now_s, formed)
        requests = () if flight.phase is FORMATION else self._enter(now_s, vehicle, flight, consensus, rft)
        events += slots.update(now_s, reference_s, consensus.peers.flying, flight.phase in STREAMING)
        self._slot = slots.flown
        if heading:
            self._turn(heading, now_s, flight, consensus, rft)
        refusal_to_enter, warning_to_enter = None, None
        if flight.phase in MAY_FORM and (_forms(commands) or _forms(checks)):
            judge = self._entry.judge_command if _forms(commands) else self._entry.judge_check
            refusal_to_enter, warning_to_enter = judge(self._entering(now_s, vehicle, consensus), rft)
        return Guidance(
            slot=self._slot,
            plan_slot=slots.flown,
            heading=heading.flown if heading else EAST,
            published_heading=heading.published if heading else EAST,
            reference=reference,
            held_reference=references.held if references else None,
            described=references.described if references else None,
            target_age_s=references.target_age_s if references else None,
            refusal_to_lead=refusal_to_lead,
            refusal_to_enter=refusal_to_enter,
            warning_to_enter=warning_to_enter,
            offered=slots.to_pass_on(consensus.peers.packets) if leads else None,
            rejected=references.rejected if references else NONE_REJECTED,
            answers=changed.answers,
            requests=requests,
            events=events,
        )

    def _restart(self) -> tuple[Notice, ...]:
        """Mission time restarts with the next flight. The event of a cancelled change."""
        if self._heading:
            self._heading.restart()
        return self._slots.restart()

    def _turn(
        self, heading: CourseHeading, now_s: float, flight: Flight, consensus: Consensus, rft: FormationState | None
    ) -> None:
        """Turn the own slot to the heading of this tick. `rft` is R of a leader."""
        if consensus.lead.heading is not None and not flight.streams:
            heading.restart()  # this vehicle does not fly by it, so it may step to the reported one
        heading.update(now_s, consensus, rft if flight.in_formation else None, self._slots.reach_m)
        self._slot = turned_slot(self._slots.flown, heading.flown)

    def _refusal_to_lead(
        self, now_s: float, vehicle: VehicleState, references: ReferencePlan, planned: FormationState, follows: bool
    ) -> Notice | None:
        """Why this vehicle must not become leader. `follows`: it flies in formation as a follower."""
        missing = references.missing(now_s)
        return (self._off_fleet(vehicle, planned) or missing) if follows else missing

    def _off_fleet(self, vehicle: VehicleState, planned: FormationState) -> Notice | None:
        """The refusal where R of this vehicle is more than MAX_OFF_FLEET_M from the fleet, by its own position.

        A vehicle that received the RFT late, or restarted meanwhile, may have changed to it by another hand-over. Up to that
        distance it leads in.
        """
        own = formation_state(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self._slot)
        off_m = dist(own.position_enu_m, planned.position_enu_m)
        if off_m <= MAX_OFF_FLEET_M:
            return None
        text = f"the reference of this vehicle is {off_m:.1f} m from where the fleet flies"
        return Notice(Code.REFERENCE_OFF_FLEET, text)

    def _entering(self, now_s: float, vehicle: VehicleState, consensus: Consensus) -> Entering:
        armed = [peer for peer in consensus.peers.fresh.values() if peer.packet.armed]
        heading = self._heading.flown if self._heading else EAST
        return Entering(now_s, vehicle, armed, heading, self._slots.slots_enu_m)

    def _enter(
        self, now_s: float, vehicle: VehicleState, flight: Flight, consensus: Consensus, rft: FormationState | None
    ) -> tuple[PhaseRequest, ...]:
        """Until the autopilot takes the stream, the path into the slot begins where this vehicle is."""
        slots = self._slots
        if flight.phase not in STREAMING:
            slots.end_path()
        elif flight.phase is ENGAGE:
            slots.end_path()
            try:
                path = self._entry.path(self._entering(now_s, vehicle, consensus), rft)
            except Refused as refusal:
                return (PhaseRequest(PhaseChange.HAND_OVER, refusal.notice.about("does not enter formation")),)
            if path:
                slots.start_path(path, now_s)
        return ()


def _forms(commands: Collection[Command]) -> bool:
    return any(command.name is CommandName.FORM for command in commands)
