"""Which slot this vehicle flies: the fleet file's, or one that a command brought, gone to in step with all others.

A change begins at a time of the fleet's (how far into the RFT it is) that all vehicles count, and only where every vehicle that
is heard has the same change waiting: one that missed the command would stand in the others' way.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from companion.geometry.curves import between
from companion.geometry.transition import closest, fastest_m_s
from companion.types import MAX_EPOCHS_AHEAD, FlownSlot, FormationChange, PeerPacket, Vector3

LATEST_S = 60.0  # ahead of the fleet's time
LONGEST_S = 600.0


class SlotPlan:
    """One vehicle's. `events` tells of changes, until somebody takes it."""

    def __init__(
        self, own_id: int, slots_enu_m: Mapping[int, Vector3], separation_m: float, max_speed_m_s: float
    ) -> None:
        """`slots_enu_m` are the fleet file's; no change may bring two slots nearer than `separation_m`, also on the way."""
        self._own_id = own_id
        self._separation_m = separation_m
        self._max_speed_m_s = max_speed_m_s
        self._before_enu_m = self.slots_enu_m = dict(slots_enu_m)  # of the formation flown, or gone to
        self._flown = FormationChange(0, tuple(sorted(slots_enu_m.items())), 0.0, 0.0)
        self._waiting: FormationChange | None = None
        self.flown = FlownSlot(slots_enu_m[own_id])
        self.events: list[str] = []

    def obey(self, change: FormationChange, reference_s: float, others: Iterable[PeerPacket]) -> tuple[bool, str]:
        """(accepted, why not or what happens now). `others` are those that fly in formation; of nobody else is it a change."""
        if change in (self._waiting, self._flown):
            return True, f"formation {change.number} is known"
        late = any(other.slot.formation == change.number for other in others)
        if refusal := self._refusal(change, reference_s, late):
            return False, f"formation: {refusal}"
        if late:
            self._take(change)
            self._before_enu_m = self.slots_enu_m
            return True, f"formation {change.number}, which the others fly"
        self._waiting = change
        return True, f"formation {change.number} begins in {change.begins_s - reference_s:.1f} s"

    def update(self, reference_s: float, others: Iterable[PeerPacket]) -> FlownSlot:
        """The slot to be flown now. `others` are all that are heard of and fly."""
        waiting = self._waiting
        if waiting is not None and reference_s >= waiting.begins_s:
            self._waiting = None
            lacking = sorted(o.vehicle_id for o in others if waiting.number not in (o.slot.formation, o.slot.waiting))
            if lacking:
                self.events.append(f"formation {waiting.number} does not begin: vehicle {lacking[0]} does not have it")
            else:
                self.events.append(f"formation {self._flown.number} -> {waiting.number}")
                self._take(waiting)
        flown, own_id = self._flown, self._own_id
        motion = between(
            self._before_enu_m[own_id], self.slots_enu_m[own_id], reference_s - flown.begins_s, flown.lasts_s
        )
        number = self._waiting.number if self._waiting else flown.number
        self.flown = FlownSlot(*motion, flown.number, number)
        return self.flown

    def landed(self) -> None:
        """The fleet's time begins anew with the next flight; the formation stays."""
        if self._flown.lasts_s or self._waiting:
            self._flown = FormationChange(self._flown.number, self._flown.slots_enu_m, 0.0, 0.0)
            self._before_enu_m, self._waiting = self.slots_enu_m, None

    def _take(self, change: FormationChange) -> None:
        self._before_enu_m, self.slots_enu_m = self.slots_enu_m, dict(change.slots_enu_m)
        self._flown, self._waiting = change, None

    def _refusal(self, change: FormationChange, reference_s: float, late: bool) -> str | None:
        slots_enu_m = dict(change.slots_enu_m)
        if slots_enu_m.keys() != self.slots_enu_m.keys() or len(slots_enu_m) != len(change.slots_enu_m):
            return f"slots for vehicles {sorted(slots_enu_m)}; expected {sorted(self.slots_enu_m)}"
        if not self._flown.number < change.number <= self._flown.number + MAX_EPOCHS_AHEAD:
            return f"number {change.number} is not newer than {self._flown.number}"
        if late:
            return None
        if not reference_s < change.begins_s <= reference_s + LATEST_S:
            return f"begins at {change.begins_s:.1f} s of the fleet's time, which is {reference_s:.1f} s now"
        if not 0.0 < change.lasts_s <= LONGEST_S:
            return f"lasts {change.lasts_s:.1f} s; expected up to {LONGEST_S:g} s"
        if reference_s < self._flown.begins_s + self._flown.lasts_s:
            return f"formation {self._flown.number} is still being taken up"
        distance_m, i, j = closest(self.slots_enu_m, slots_enu_m)
        if not distance_m >= self._separation_m:
            return (
                f"the slots of vehicles {i} and {j} come within {distance_m:.2f} m of each other;"
                f" expected at least separation_m, {self._separation_m:g} m"
            )
        speed_m_s = fastest_m_s(self.slots_enu_m, slots_enu_m, change.lasts_s)
        if not speed_m_s <= self._max_speed_m_s:
            return f"slots move at up to {speed_m_s:.1f} m/s; expected at most {self._max_speed_m_s:g} m/s"
        return None
