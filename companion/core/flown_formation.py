"""The formation as this vehicle flies it: its slot, turned to the heading, the RFT where it leads, and the way in."""

from __future__ import annotations

from collections.abc import Iterable
from math import dist

from companion.core.cooperation import Neighbourhood
from companion.core.formation import Place, place
from companion.core.heading import FormationHeading
from companion.core.joining import Joining, Way
from companion.core.peers import PeerTable
from companion.core.phase import STREAMING, PhaseMachine
from companion.core.reference_plan import ReferencePlan
from companion.core.slot_plan import SlotPlan
from companion.geometry.turning import turned_slot
from companion.types import FlightPhase, ReceivedTarget, Role, VehicleState

MAX_ASTRAY_M = 3.0  # more than a vehicle in formation is ever off its place


class FlownFormation:
    """One vehicle's. `slot` is the one that it flies now, turned to the heading; `reference` is R for a leader alone, whoever
    else holds the RFT.

    `references` is given to those that may lead, and to no other.
    """

    def __init__(
        self,
        own_id: int,
        machine: PhaseMachine,
        peers: PeerTable,
        slots: SlotPlan,
        heading: FormationHeading,
        references: ReferencePlan | None,
        joining: Joining,
    ) -> None:
        self._own_id = own_id
        self._machine = machine
        self._peers = peers
        self._joining = joining
        self.joins = False  # others were in formation already when this vehicle was told to form
        self.slots = slots
        self.heading = heading
        self.references = references
        self.slot = slots.flown
        self.reference: Place | None = None
        self._astray_m = 0.0

    def landed(self) -> None:
        """The fleet's time begins anew with the next flight."""
        self.slots.begin_anew()
        self.heading.begin_anew()

    def update(
        self, now_s: float, vehicle: VehicleState, around: Neighbourhood, targets: Iterable[ReceivedTarget]
    ) -> None:
        """Once a tick: the slot and R of this tick."""
        self._join(now_s, vehicle, around)
        slots, reference_s = self.slots, around.reference_s
        slots.update(reference_s, around.flying, self._machine.phase in STREAMING)
        if self.references:
            self.references.update(now_s, reference_s, slots.slots_enu_m, around.flying, targets)
            held = self.references.at(reference_s)
            self.reference = held if around.role is Role.LEADER else None
            self._astray_m = self._astray(vehicle, held)
        if around.heading is not None and not self._machine.streams(vehicle):
            self.heading.begin_anew()  # nobody flies by it here: it need not turn to what is heard as vehicles must
        led_by = self.reference if self._machine.in_formation else None
        self.heading.update(now_s, around, led_by, slots.reach_m)
        self.slot = turned_slot(slots.flown, self.heading.flown)

    def refusal_to_lead(self, now_s: float) -> str:
        """Why this vehicle must not take the lead just now; "" where nothing is known against it."""
        if self.references is None:
            return ""
        if self.reference is None and self._astray_m > MAX_ASTRAY_M:
            return f"the reference as this vehicle has it is {self._astray_m:.1f} m from where the fleet flies"
        return self.references.missing(now_s)

    def _astray(self, vehicle: VehicleState, held: Place) -> float:
        """How far R as it is held here is from where this vehicle has the fleet, by its own place; 0 out of formation.

        One that was given the RFT late, or was started anew meanwhile, may have come to it by another hand-over.
        """
        if self._machine.phase is not FlightPhase.FORMATION:
            return 0.0
        here = place(vehicle.position_enu_m, vehicle.velocity_enu_m_s, self.slot)
        return dist(here.position_enu_m, held.position_enu_m)

    def refusal_to_join(self, now_s: float, vehicle: VehicleState) -> str:
        """Why there is no way in for one that is told to form now; "" where there is, or where none is needed."""
        self.joins = self._joining.is_due(now_s)
        if self.joins:
            try:
                self._way_in(now_s, vehicle)
            except ValueError as error:
                return str(error)
        return ""

    def _join(self, now_s: float, vehicle: VehicleState, around: Neighbourhood) -> None:
        """Until the autopilot takes the stream, from wherever this vehicle is."""
        self._joining.hear(now_s, around.flying)
        phase = self._machine.phase
        if phase not in STREAMING:
            self.joins = False
            self.slots.end_coming()
        elif self.joins and phase is FlightPhase.ENGAGE:
            try:
                self.slots.come(self._way_in(now_s, vehicle), around.reference_s)
            except ValueError as error:
                self._machine.hand_over(now_s, vehicle, f"does not join: {error}")

    def _way_in(self, now_s: float, vehicle: VehicleState) -> Way:
        """Raises ValueError where there is none."""
        flying = [peer for peer in self._peers.fresh(now_s).values() if peer.packet.armed]
        slot_enu_m = self.slots.slots_enu_m[self._own_id]
        heading = self.heading.flown
        return self._joining.way(now_s, vehicle.position_enu_m, vehicle.velocity_enu_m_s, slot_enu_m, heading, flying)
