"""When one has left: the others close up, so that the gap comes to lie outside, where it can come back without moving anybody.

Whoever leads proposes it, as a formation with the next number, which all then judge and fly like a commanded one. It waits
until the place is free: who left may hold in the air exactly there. Silence is no leaving: who is heard no more may fly on
in its slot, with a transmitter that is broken, or lead a part of the fleet that this one does not hear.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import dist, hypot

from companion.core.formation_limits import FormationLimits
from companion.core.peers import PeerState
from companion.core.phase import STREAMING
from companion.geometry.curves import between, duration_s
from companion.types import FlightPhase, FormationChange, PeerPacket, Vector3

GONE_FOR_S = 3.0  # a short loss of packets moves nobody
LOOKS_AGAIN_S = 0.5
TRIES_AGAIN_S = 10.0  # what was proposed and did not begin
AHEAD_S = 1.5  # until the first movement: time for every vehicle to get it
ACCELERATION_M_S2 = 1.0  # of a slot
AS_FAR_M = 0.01
SAMPLES = 100

Slots = Mapping[int, Vector3]
Place2 = tuple[float, float]
Reference = Callable[[float], Vector3]
"""r at a time of the fleet's."""


def closed_up(slots_enu_m: Slots, gone_id: int, present: Collection[int]) -> dict[int, Vector3]:
    """The same slots, the gap filled from outside until nobody is farther from the RFT than the gap.

    Each time the nearest of those that are farther moves into it, and leaves a gap of its own. The last is for who is gone.
    """
    slots, gap = dict(slots_enu_m), slots_enu_m[gone_id]
    while farther := [i for i in present if hypot(*slots[i]) > hypot(*gap) + AS_FAR_M]:
        nearest = min(farther, key=lambda i: (dist(slots[i], gap), i))
        slots[nearest], gap = gap, slots[nearest]
    slots[gone_id] = gap
    return slots


class ClosingUp:
    """One vehicle's count of who left. `events` says why a gap is kept, once for each absence."""

    def __init__(self, own_id: int, limits: FormationLimits) -> None:
        self._own_id = own_id
        self._limits = limits
        self._gone_s: dict[
            int, float | None
        ] = {}  # since when; None: in formation. Of all that were in it in this flight
        self._told: set[int] = set()
        self._looks_again_s = 0.0
        self.events: list[str] = []

    def landed(self) -> None:
        """Whoever was in formation is forgotten."""
        self._gone_s.clear()
        self._told.clear()

    def hear(self, now_s: float, flying: Collection[PeerPacket]) -> None:
        """Once a tick: all others that are heard of and fly."""
        present = {packet.vehicle_id for packet in flying if packet.phase is FlightPhase.FORMATION}
        for i in present:
            self._gone_s[i] = None
        for i, since_s in self._gone_s.items():
            if since_s is None and i not in present:
                self._gone_s[i] = now_s
        self._told -= present

    def proposal(
        self,
        now_s: float,
        slots_enu_m: Slots,
        number: int,
        newest: Mapping[int, PeerState],
        reference_s: float,
        reference: Reference,
    ) -> tuple[int, FormationChange] | None:
        """(who left, the formation without it), for who leads and flies in formation; None while there is nothing to be done.

        `number` is the newest formation's that this vehicle has; `newest` is what every peer said last, however long ago.
        """
        if now_s < self._looks_again_s:
            return None
        self._looks_again_s = now_s + LOOKS_AGAIN_S
        present = [self._own_id, *(i for i, since_s in self._gone_s.items() if since_s is None)]
        absent = sorted(self._gone_s.keys() - set(present))
        number = 1 + max([number, *(peer.packet.slot.waiting for peer in newest.values())])
        for gone_id in absent:
            since_s, slots = self._gone_s[gone_id], closed_up(slots_enu_m, gone_id, present)
            if since_s is None or now_s - since_s < GONE_FOR_S or slots == slots_enu_m:
                continue
            change = self._change(number, slots_enu_m, slots, reference_s, gone_id)
            if why_not := self._refusal(change, slots_enu_m, newest.get(gone_id), now_s, reference):
                self.keep_gap(gone_id, why_not)
                continue
            self._looks_again_s = now_s + TRIES_AGAIN_S
            return gone_id, change
        return None

    def keep_gap(self, gone_id: int, why: str) -> None:
        if gone_id not in self._told:
            self._told.add(gone_id)
            self.events.append(f"vehicle {gone_id} left, and its gap is kept for now: {why}")

    def _change(self, number: int, before: Slots, after: Slots, reference_s: float, gone_id: int) -> FormationChange:
        longest_m = max(dist(before[i], after[i]) for i in before if i != gone_id)
        return FormationChange(
            number=number,
            slots_enu_m=tuple(sorted(after.items())),
            begins_s=reference_s + AHEAD_S,
            lasts_s=duration_s(longest_m, self._limits.speed_m_s, ACCELERATION_M_S2),
            absent=(gone_id,),
        )

    def _apart_m(self, slot_m: Place2, gone_m: Place2) -> float:
        """In the plane, both about the RFT; of slots that turn, whichever way they may point by then."""
        if self._limits.slots_turn:
            return abs(hypot(*slot_m) - hypot(*gone_m))
        return dist(slot_m, gone_m)

    def _refusal(
        self, change: FormationChange, before: Slots, gone: PeerState | None, now_s: float, reference: Reference
    ) -> str:
        if gone is None:
            return "nothing was ever heard of it"
        if not gone.packet.armed:
            return ""
        if gone.packet.phase in STREAMING:
            return "nothing is heard of it, and it may fly on in its slot"
        x, y, _ = gone.position_at(now_s) if now_s - gone.measured_s < GONE_FOR_S else gone.packet.position_enu_m
        after = dict(change.slots_enu_m)
        for k in range(SAMPLES + 1):
            elapsed_s = change.lasts_s * k / SAMPLES
            rx, ry, _ = reference(change.begins_s + elapsed_s)
            for i in after.keys() - set(change.absent):
                dx, dy, _ = between(before[i], after[i], elapsed_s, change.lasts_s)[0]
                apart_m = self._apart_m((dx, dy), (x - rx, y - ry))
                if before[i] != after[i] and apart_m < self._limits.separation_m:
                    return f"it may still be in the air, {apart_m:.2f} m beside the way of vehicle {i}"
        return ""
