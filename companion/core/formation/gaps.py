"""Gap filling: after a vehicle has left, the others move up until its gap is at the edge of the formation.

It can then come back without moving another vehicle. The first leader proposes this as a formation with the next number, which
all vehicles check and fly like a commanded one. It waits until the slot is free: the vehicle that left may hold in the air
exactly there. A silent vehicle has not left: it may fly on in its slot with a broken transmitter, or lead a part of the fleet
that this vehicle does not receive.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from math import dist, hypot

from msgspec import Struct

from companion.core.consensus.peers import PeerState
from companion.core.formation.limits import FormationLimits
from companion.geometry.curves import duration_s, rest_to_rest
from companion.geometry.formations import SLOT_ACCELERATION_M_S2
from companion.types.flight import STREAMING, FlightPhase
from companion.types.formation import FormationChange
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket
from companion.types.values import MIN_CHANGE_S, Vector3

FORMATION = FlightPhase.FORMATION  # member lookup of an enum is slow
GONE_FOR_S = 3.0  # a short loss of packets moves no vehicle
CHECK_PERIOD_S = 0.5
RETRY_AFTER_S = 10.0  # a proposal that did not begin is made again
AHEAD_S = 1.5  # from the proposal to the first movement: time for every vehicle to receive it
DISTANCE_TOLERANCE_M = 0.01
SAMPLES = 100
CHANGES_MISSED = 16  # as many as a vehicle may have missed; a peer with a larger number is wrong

Slots = Mapping[int, Vector3]
Position2 = tuple[float, float]
Reference = Callable[[float], Vector3]
"""r, ENU metres, at a mission time."""


def closed_up(slots_enu_m: Slots, gone_id: int, present: Collection[int]) -> dict[int, Vector3]:
    """The slots with the gap filled from outside, until no present vehicle is farther from the RFT than the gap.

    In each step the nearest vehicle that is farther out moves into the gap and leaves a gap of its own. The last gap becomes
    the slot of the vehicle that left.
    """
    slots, gap = dict(slots_enu_m), slots_enu_m[gone_id]
    while farther := [i for i in present if hypot(*slots[i]) > hypot(*gap) + DISTANCE_TOLERANCE_M]:
        nearest = min(farther, key=lambda i: (dist(slots[i], gap), i))
        slots[nearest], gap = gap, slots[nearest]
    slots[gone_id] = gap
    return slots


class Proposal(Struct, frozen=True, gc=False):
    """A formation without vehicle `gone_id`; `change` is None where there is nothing to propose. `events`: gaps kept."""

    gone_id: int = 0
    change: FormationChange | None = None
    events: tuple[Notice, ...] = ()


NO_PROPOSAL = Proposal()


class GapFilling:
    """Since when each vehicle has been out of formation. A kept gap is reported once for each absence."""

    def __init__(self, own_id: int, limits: FormationLimits) -> None:
        self._own_id = own_id
        self._limits = limits
        # Since when each vehicle that was in formation in this flight is out of it; None while it is in formation
        self._gone_s: dict[int, float | None] = {}
        self._reported: set[int] = set()
        self._next_check_s = 0.0

    def restart(self) -> None:
        """After a landing: forget which vehicles were in formation."""
        self._gone_s.clear()
        self._reported.clear()

    def update(self, now_s: float, flying: Collection[PeerPacket]) -> None:
        """Once a tick, with all fresh peers that fly."""
        present = {packet.sender.vehicle_id for packet in flying if packet.phase is FORMATION}
        for i in present:
            self._gone_s[i] = None
        for i, since_s in self._gone_s.items():
            if since_s is None and i not in present:
                self._gone_s[i] = now_s
        self._reported -= present

    def propose(
        self,
        now_s: float,
        slots_enu_m: Slots,
        number: int,
        newest: Mapping[int, PeerState],
        reference_s: float,
        reference: Reference,
    ) -> Proposal:
        """The formation without a vehicle that left, for the first leader while it flies in formation.

        `number` is of the newest formation that this vehicle has; `newest` holds the last packet of every peer, however old.
        """
        if now_s < self._next_check_s:
            return NO_PROPOSAL
        self._next_check_s = now_s + CHECK_PERIOD_S
        present = [self._own_id, *(i for i, since_s in self._gone_s.items() if since_s is None)]
        absent = sorted(self._gone_s.keys() - set(present))
        waiting = [peer.packet.slot.waiting for peer in newest.values()]
        number = 1 + max([number, *(w for w in waiting if w <= number + CHANGES_MISSED)])
        events: tuple[Notice, ...] = ()
        for gone_id in absent:
            since_s, slots = self._gone_s[gone_id], closed_up(slots_enu_m, gone_id, present)
            if since_s is None or now_s - since_s < GONE_FOR_S or slots == slots_enu_m:
                continue
            change = self._change(number, slots_enu_m, slots, reference_s, gone_id)
            if reason := self._refusal(change, slots_enu_m, newest.get(gone_id), now_s, reference):
                events += self.keep_gap(gone_id, reason)
                continue
            self._next_check_s = now_s + RETRY_AFTER_S
            return Proposal(gone_id, change, events)
        return Proposal(events=events) if events else NO_PROPOSAL

    def keep_gap(self, gone_id: int, reason: str) -> tuple[Notice, ...]:
        """The event of a kept gap; none where this absence was reported before."""
        if gone_id in self._reported:
            return ()
        self._reported.add(gone_id)
        return (Notice(Code.GAP_KEPT, f"vehicle {gone_id} left, its gap is kept for now: {reason}"),)

    def _change(self, number: int, before: Slots, after: Slots, reference_s: float, gone_id: int) -> FormationChange:
        longest_m = max(dist(before[i], after[i]) for i in before if i != gone_id)
        return FormationChange(
            number=number,
            slots_enu_m=tuple(sorted(after.items())),
            begins_s=reference_s + AHEAD_S,
            lasts_s=max(MIN_CHANGE_S, duration_s(longest_m, self._limits.speed_m_s, SLOT_ACCELERATION_M_S2)),
            absent=(gone_id,),
        )

    def _apart_m(self, slot_m: Position2, gone_m: Position2) -> float:
        """Horizontal distance, both relative to the RFT; where slots turn, the smallest over all headings."""
        if self._limits.slots_turn:
            return abs(hypot(*slot_m) - hypot(*gone_m))
        return dist(slot_m, gone_m)

    def _refusal(
        self, change: FormationChange, before: Slots, gone: PeerState | None, now_s: float, reference: Reference
    ) -> str:
        """Why the slot of the vehicle that left may not be free; "" where it is."""
        if gone is None:
            return "no packet of it was ever received"
        if not gone.packet.armed:
            return ""
        if gone.packet.phase in STREAMING:
            return "no packets come from it, and it may still fly in its slot"
        x, y, _ = gone.position_at(now_s) if now_s - gone.measured_s < GONE_FOR_S else gone.packet.motion.position_enu_m
        after = dict(change.slots_enu_m)
        for k in range(SAMPLES + 1):
            elapsed_s = change.lasts_s * k / SAMPLES
            rx, ry, _ = reference(change.begins_s + elapsed_s)
            for i in after.keys() - set(change.absent):
                dx, dy, _ = rest_to_rest(before[i], after[i], elapsed_s, change.lasts_s)[0]
                apart_m = self._apart_m((dx, dy), (x - rx, y - ry))
                if before[i] != after[i] and apart_m < self._limits.separation_m:
                    return f"it may still be in the air, {apart_m:.2f} m beside the path of vehicle {i}"
        return ""
