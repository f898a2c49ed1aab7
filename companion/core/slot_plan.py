"""Which slot this vehicle flies: the fleet file's, or one that a command brought, gone to in step with all others.

A change begins at a time of the fleet's (how far into the RFT it is) that all vehicles count, and only where every vehicle that
is heard has the same change waiting: one that missed the command would stand in the others' way. On the ground that time does
not run, and nothing moves: there a change is taken up at once.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from companion.core.formation_limits import FormationLimits
from companion.core.joining import Way
from companion.core.phase import STREAMING
from companion.core.reference_clock import FALLS_BACK_S
from companion.geometry.curves import Motion, between
from companion.geometry.turning import reach_m
from companion.types import MAX_EPOCHS_AHEAD, ZERO3, FlightPhase, FlownSlot, FormationChange, PeerPacket, Vector3

LATEST_S = 60.0  # ahead of the fleet's time
LONGEST_S = 600.0


class SlotPlan:
    """One vehicle's. `events` tells of changes, until somebody takes it."""

    def __init__(self, own_id: int, slots_enu_m: Mapping[int, Vector3], limits: FormationLimits) -> None:
        """`slots_enu_m` are the fleet file's; `limits` hold for all others."""
        self._own_id = own_id
        self._limits = limits
        self._before_enu_m = self.slots_enu_m = dict(slots_enu_m)  # of the formation flown, or gone to
        self._reach_before_m = self._reach_m = reach_m(slots_enu_m.values())
        self._flown = FormationChange(0, tuple(sorted(slots_enu_m.items())), 0.0, 0.0)
        self._waiting: FormationChange | None = None
        self._way: tuple[Way, float] | None = None  # while it joins, with its beginning
        self._reference_s = 0.0
        self.flown = FlownSlot(slots_enu_m[own_id])
        self.events: list[str] = []

    def obey(
        self,
        change: FormationChange,
        reference_s: float,
        others: Iterable[PeerPacket],
        rft_enu_m: Iterable[Vector3],
    ) -> tuple[bool, str]:
        """(accepted, why not or what happens now). `others` are those that fly in formation; of nobody else is it a change.

        `rft_enu_m` are places of the RFT, as far as this vehicle knows them: about none may a slot lie outside the fence.
        """
        if change in (self._waiting, self._flown):
            return True, f"formation {change.number} is known"
        if _is_flown(change, others):
            return self._take_over(change)
        refusal = self._refusal(change, rft_enu_m) or self._refusal_of_way(change, reference_s)
        if refusal:
            return False, f"formation: {refusal}"
        self._waiting = change
        return True, f"formation {change.number} begins in {change.begins_s - reference_s:.1f} s"

    def obey_on_ground(
        self, change: FormationChange, flying: Collection[PeerPacket], rft_enu_m: Iterable[Vector3]
    ) -> tuple[bool, str]:
        """The same of a vehicle that stands: it moves nothing. `flying` are those that are in the air."""
        if change == self._flown:
            return True, f"formation {change.number} is known"
        if _is_flown(change, [other for other in flying if other.phase is FlightPhase.FORMATION]):
            return self._take_over(change)
        slots_enu_m = dict(change.slots_enu_m)
        refusal = self._refusal(change, rft_enu_m) or self._limits.refusal_of_distance(slots_enu_m, slots_enu_m)
        if refusal:
            return False, f"formation: {refusal}"
        if flying:
            return True, f"formation {change.number} is taken over here when the others fly it"
        self._take(_begun(change))
        self._before_enu_m = self.slots_enu_m
        return True, f"formation {change.number}, on the ground at once"

    def lacks(self, change: FormationChange, over_own: bool) -> bool:
        """Is this one new here that a leader passes on? With `over_own` also where another of its number waits."""
        waiting, flown = self._waiting, self._flown
        if waiting is not None and change.number <= waiting.number:
            return over_own and change.number == waiting.number and change != waiting
        return change.number != flown.number

    def is_settled(self, reference_s: float) -> bool:
        """Nothing waits, and what is flown is taken up."""
        return self._waiting is None and reference_s >= self._flown.begins_s + self._flown.lasts_s

    def to_pass_on(self, others: Iterable[PeerPacket]) -> FormationChange | None:
        """What a leader tells all. `others` are all that are heard of, whatever they do.

        What waits is told as long as it does, so that all have the same in the end; what is flown, while somebody has it not.
        """
        if self._waiting:
            return self._waiting
        number = self._flown.number
        lacked = any(number not in (other.slot.formation, other.slot.waiting) for other in others)
        return self._flown if lacked else None

    def update(self, reference_s: float, others: Collection[PeerPacket], in_formation: bool) -> FlownSlot:
        """The slot to be flown now. `others` are all that are heard of and fly; `in_formation` is this vehicle."""
        if reference_s < self._reference_s - FALLS_BACK_S:  # who leads has landed meanwhile, or was started anew
            self.begin_anew()
        self._reference_s = reference_s
        waiting = self._waiting
        if waiting is not None and reference_s >= waiting.begins_s:
            self._waiting = None
            present = {o.vehicle_id for o in others if o.phase in STREAMING} | (
                {self._own_id} if in_formation else set()
            )
            back = sorted(present & set(waiting.absent))
            lacking = sorted(o.vehicle_id for o in others if waiting.number not in (o.slot.formation, o.slot.waiting))
            if back:
                self.events.append(f"formation {waiting.number} does not begin: vehicle {back[0]} is back in formation")
            elif lacking:
                self.events.append(f"formation {waiting.number} does not begin: vehicle {lacking[0]} does not have it")
            else:
                self.events.append(f"formation {self._flown.number} -> {waiting.number}")
                self._take(waiting)
        flown, own_id = self._flown, self._own_id
        motion = between(
            self._before_enu_m[own_id], self.slots_enu_m[own_id], reference_s - flown.begins_s, flown.lasts_s
        )
        if self._way:
            motion = self._on_the_way(*self._way, motion, reference_s)
        number = self._waiting.number if self._waiting else flown.number
        self.flown = FlownSlot(*motion, flown.number, number, moves=motion[1] != ZERO3)
        return self.flown

    @property
    def reach_m(self) -> float:
        """From the RFT to the outermost slot of any vehicle, in the plane; on the way the larger of both formations'."""
        return max(self._reach_before_m, self._reach_m) if self.flown.moves else self._reach_m

    def begin_anew(self) -> None:
        """The fleet's time does, as with the next flight; the formation stays."""
        if self._waiting:
            self.events.append(f"formation {self._waiting.number} does not begin: the fleet's time begins anew")
        self._flown, self._before_enu_m, self._waiting = _begun(self._flown), self.slots_enu_m, None

    def come(self, way: Way, reference_s: float) -> None:
        """Join by this way from this time of the fleet's on."""
        self._way = (way, reference_s)

    def end_coming(self) -> None:
        """Whatever way was begun: this vehicle is in formation no more."""
        self._way = None

    def _on_the_way(self, way: Way, begun_s: float, motion: Motion, reference_s: float) -> Motion:
        delta, lasts_s = way
        if reference_s >= begun_s + lasts_s:
            self._way = None
            self.events.append("has joined: it is in its slot")
            return motion
        x, y, z = (_plus(a, b) for a, b in zip(motion, delta(reference_s - begun_s), strict=True))
        return x, y, z

    def _take(self, change: FormationChange) -> None:
        self._before_enu_m, self.slots_enu_m = self.slots_enu_m, dict(change.slots_enu_m)
        self._reach_before_m, self._reach_m = self._reach_m, reach_m(self.slots_enu_m.values())
        self._flown, self._waiting = change, None

    def _take_over(self, change: FormationChange) -> tuple[bool, str]:
        """What others fly already, at its end at once: of who does not fly in formation nothing moves.

        Whatever its number: this vehicle may have heard of a newer one that came to nothing.
        """
        if refusal := self._refusal_of_form(change):
            return False, f"formation: {refusal}"
        self._take(change)
        self._before_enu_m = self.slots_enu_m
        return True, f"formation {change.number}, which the others fly"

    def _refusal_of_form(self, change: FormationChange) -> str | None:
        ids = [vehicle_id for vehicle_id, _ in change.slots_enu_m]
        if sorted(ids) != sorted(self.slots_enu_m):
            return f"slots for vehicles {sorted(ids)}; expected {sorted(self.slots_enu_m)}"
        if change.number > self._flown.number + MAX_EPOCHS_AHEAD:
            return f"number {change.number} is too far ahead of {self._flown.number}"
        return None

    def _refusal(self, change: FormationChange, rft_enu_m: Iterable[Vector3]) -> str | None:
        """Whenever it is to begin."""
        if refusal := self._refusal_of_form(change):
            return refusal
        if change.number <= self._flown.number:
            return f"number {change.number} is not newer than {self._flown.number}"
        return self._limits.refusal_of_places(dict(change.slots_enu_m), rft_enu_m)

    def _refusal_of_way(self, change: FormationChange, reference_s: float) -> str | None:
        """When and how it would be flown, from the formation that is flown now."""
        if not reference_s < change.begins_s <= reference_s + LATEST_S:
            return f"begins at {change.begins_s:.1f} s of the fleet's time, which is {reference_s:.1f} s now"
        if not 0.0 < change.lasts_s <= LONGEST_S:
            return f"lasts {change.lasts_s:.1f} s; expected up to {LONGEST_S:g} s"
        if self._way:
            return "this vehicle is still joining"
        if reference_s < self._flown.begins_s + self._flown.lasts_s:
            return f"formation {self._flown.number} is still being taken up"
        slots_enu_m = dict(change.slots_enu_m)
        present = slots_enu_m.keys() - set(change.absent)
        before, after = ({i: slots[i] for i in present} for slots in (self.slots_enu_m, slots_enu_m))
        return self._limits.refusal_of_way(before, after, change.lasts_s) or (
            self._limits.refusal_of_distance(slots_enu_m, slots_enu_m) if change.absent else None
        )


def _is_flown(change: FormationChange, others: Iterable[PeerPacket]) -> bool:
    return any(other.slot.formation == change.number for other in others)


def _begun(change: FormationChange) -> FormationChange:
    """It is flown from the beginning of the fleet's time on."""
    return FormationChange(change.number, change.slots_enu_m, 0.0, 0.0)


def _plus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])
