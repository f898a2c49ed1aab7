"""Changes of what the fleet flies: commanded, passed on by who leads, or proposed by who leads where one left.

Wherever one comes from, this vehicle judges it by itself.
"""

from __future__ import annotations

from collections.abc import Iterable

from companion.core.closing_up import ClosingUp
from companion.core.command_desk import Order
from companion.core.cooperation import Cooperation, Neighbourhood
from companion.core.flown_formation import FlownFormation
from companion.core.formation import place
from companion.core.passed_on import first_leader, passed_on
from companion.core.phase import PhaseMachine
from companion.types import (
    FlightPhase,
    FormationChange,
    ReferenceChange,
    Role,
    Vector3,
    VehicleState,
)


class Changes:
    """One vehicle's. `events` tells of formations that came without a command, until somebody takes it."""

    def __init__(
        self,
        own_id: int,
        machine: PhaseMachine,
        cooperation: Cooperation,
        formation: FlownFormation,
        closing_up: ClosingUp | None,
    ) -> None:
        self._own_id = own_id
        self._machine = machine
        self._cooperation = cooperation
        self._formation = formation
        self._closing_up = closing_up  # None: whoever leaves, its gap is kept
        self._not_taken: int | None = None  # the formation passed on that was refused last, and told of
        self.events: list[str] = []

    def update(self, now_s: float, orders: Iterable[Order], vehicle: VehicleState, around: Neighbourhood) -> None:
        """Once a tick. What is commanded goes before what others pass on, and that before what this vehicle would propose."""
        for order in orders:
            if order.answer is not None:
                continue
            match order.command.content:
                case FormationChange() as change:
                    order.answer = self._change_formation(change, vehicle, around)
                case ReferenceChange() as change:
                    order.answer = self._change_reference(change, vehicle, around)
        self._hear_of_formations(vehicle, around)
        if self._closing_up:
            self._close_up(self._closing_up, now_s, vehicle, around)

    def to_pass_on(self, now_s: float, around: Neighbourhood) -> FormationChange | None:
        """What this vehicle tells all others where it leads in formation; else None, as where all have what it flies."""
        if not self._leads_formation(around):
            return None
        return self._formation.slots.to_pass_on(self._cooperation.peers.heard(now_s))

    def _change_formation(
        self, change: FormationChange, vehicle: VehicleState, around: Neighbourhood
    ) -> tuple[bool, str]:
        slots, rft_enu_m = self._formation.slots, self._rft_enu_m(vehicle, around)
        if self._machine.stands(vehicle):
            return slots.obey_on_ground(change, around.flying, rft_enu_m)
        in_formation = [other for other in around.flying if other.phase is FlightPhase.FORMATION]
        alone = self._machine.phase is not FlightPhase.FORMATION
        return slots.obey(change, around.reference_s, in_formation if alone else (), rft_enu_m)

    def _change_reference(
        self, change: ReferenceChange, vehicle: VehicleState, around: Neighbourhood
    ) -> tuple[bool, str]:
        references = self._formation.references
        if references is None:
            return False, "reference: this vehicle may not lead, and knows of none"
        slots_enu_m, here_enu_m = self._formation.slots.slots_enu_m, self._here_enu_m(vehicle)
        return references.obey(change, around.reference_s, slots_enu_m, around.flying, here_enu_m)

    def _rft_enu_m(self, vehicle: VehicleState, around: Neighbourhood) -> list[Vector3]:
        """Places of the RFT, as far as they are known here: who may lead knows it, who flies in formation where it is now."""
        if self._formation.references:
            return self._formation.references.places_enu_m(around.reference_s)
        return [self._here_enu_m(vehicle)] if self._machine.phase is FlightPhase.FORMATION else []

    def _here_enu_m(self, vehicle: VehicleState) -> Vector3:
        """Where this vehicle has the fleet, by its own place."""
        return place(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self._formation.slot).position_enu_m

    def _hear_of_formations(self, vehicle: VehicleState, around: Neighbourhood) -> None:
        """What leaders pass on is taken like a command; of two that have different ones, the smallest id's."""
        first_id = self._first_leader(around)
        term, stands = self._cooperation.leadership.term, self._machine.stands(vehicle)
        for vehicle_id, change in passed_on(around.flying, term, stands):
            if not self._formation.slots.lacks(change, over_own=vehicle_id == first_id):
                continue
            accepted, reason = self._change_formation(change, vehicle, around)
            if accepted or change.number != self._not_taken:
                self.events.append(f"passed on by vehicle {vehicle_id}: {reason}")
            self._not_taken = None if accepted else change.number

    def _close_up(self, closing_up: ClosingUp, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> None:
        """Where one left, and the fleet file wants it: the first of those that lead proposes it, and all judge it."""
        if not vehicle.armed:
            closing_up.landed()
        closing_up.hear(now_s, around.flying)
        slots, references = self._formation.slots, self._formation.references
        leads = self._first_leader(around) == self._own_id
        if references is None or not leads or not slots.is_settled(around.reference_s):
            return
        proposed = closing_up.proposal(
            now_s,
            slots.slots_enu_m,
            slots.flown.waiting,
            self._cooperation.peers.newest,
            around.reference_s,
            lambda reference_s: references.at(reference_s).position_enu_m,
        )
        if proposed is None:
            return
        gone_id, change = proposed
        accepted, reason = self._change_formation(change, vehicle, around)
        if accepted:
            self.events.append(f"closes up where vehicle {gone_id} left: {reason}")
        else:
            closing_up.keep_gap(gone_id, reason)

    def _first_leader(self, around: Neighbourhood) -> int | None:
        return first_leader(around.flying, self._own_id if self._leads_formation(around) else None)

    def _leads_formation(self, around: Neighbourhood) -> bool:
        return around.role is Role.LEADER and self._machine.phase is FlightPhase.FORMATION
