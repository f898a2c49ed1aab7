"""The slot that this vehicle flies: configured in the fleet file, or changed in step with all other vehicles.

A change begins at a mission time, and only if every fresh peer holds the same change: a vehicle that missed it would be in
the path of the others. On the ground mission time does not run and nothing moves, so there a change applies at once.

While a vehicle that began the change with this one is silent, the slots slow down to a stop and wait: on both sides of a split
network the vehicles would otherwise fly on across each other's paths unseen. They go on when it is heard again.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from math import ceil

from msgspec.structs import replace

from companion.core.formation.limits import FormationLimits
from companion.core.formation.paths import Path
from companion.core.paced import BEING_CHECKED, PENDING, Pending
from companion.core.reference.agreement import Agreement
from companion.geometry.curves import rest_to_rest
from companion.geometry.formations import reach_m
from companion.geometry.vectors import plus, scaled
from companion.types.flight import STREAMING, FlightPhase
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Answer, Code, Judged, Notice, accept
from companion.types.peers import PeerPacket
from companion.types.steps import Steps, whole
from companion.types.values import MAX_CHANGE_S, MIN_CHANGE_S, ZERO3, Vector3

# Time until every vehicle knows who has accepted a change: each cancels it at its beginning where another one lacks it.
AGREED_WITHIN_S = 0.3
WAITS_S = 10.0  # for so long slots wait for silent vehicles; one that is silent longer has handed over to its autopilot
SLOWS_IN_S = 0.5  # from the full pace of a change to its stop
Check = Callable[[Steps[Notice | None]], Notice | Pending | None]
"""Does the expensive part of the checks of a change; PENDING where that takes more ticks."""


class SlotPlan:
    """The formation flown, the one that waits, and this vehicle's slot in it (`flown`)."""

    def __init__(self, own_id: int, slots_enu_m: Mapping[int, Vector3], limits: FormationLimits) -> None:
        """`slots_enu_m` are those of the fleet file; `limits` apply to every change."""
        self._own_id = own_id
        self.limits = limits
        self._before_enu_m = self.slots_enu_m = dict(slots_enu_m)  # both: slots of the formation flown or moved to
        self._reach_before_m = self._reach_m = reach_m(slots_enu_m.values())
        self._flown = FormationChange(0, tuple(sorted(slots_enu_m.items())), 0.0, 0.0)
        self._agreement: Agreement[FormationChange] = Agreement(
            "formation", Code.FORMATION_CANCELLED, known_for_s=AGREED_WITHIN_S
        )
        self._path: tuple[Path, float] | None = None  # into the slot, and when it begins on this vehicle's clock
        self.flown = FlownSlot(slots_enu_m[own_id])
        self._movers: set[int] = set()  # the others in formation when the change began
        self._pace = 1.0  # of the change; 0 while it waits
        self._behind_s = 0.0  # by waiting

    def judge(
        self,
        change: FormationChange,
        reference_s: float,
        others: Iterable[PeerPacket],
        rft_enu_m: Sequence[Vector3],
        is_command: bool = False,
        check: Check = whole,
    ) -> Judged:
        """Of a change in flight; nothing is changed yet. `others` are the peers in formation where this vehicle is not in it.

        A command may also have a smaller number than the formation flown: that was wrong, if other vehicles have a smaller one.

        `rft_enu_m` are the positions of the RFT that this vehicle knows, one a second: around none may a slot lie outside the
        fence or in an obstacle.

        `check` does the expensive part, after all other refusals: while the answer is BEING_CHECKED, ask again in the next
        tick.
        """
        if change in (self._agreement.waiting, self._flown):
            return Judged(accept(Code.FORMATION_KNOWN, f"formation {change.number} is known"))
        if _is_flown(change, others):
            return self._judge_flown(change)
        refusal = (
            self._refusal(change, rft_enu_m, is_command)
            or self._refusal_of_change(change, reference_s)
            or check(self._airspace_steps(change, reference_s, rft_enu_m))
        )
        if refusal is PENDING:
            return Judged(BEING_CHECKED)
        if refusal:
            return Judged(Answer(False, refusal.about("formation")))
        text = f"formation {change.number} begins in {change.begins_s - reference_s:.1f} s"
        if crossing := self.limits.crossing(*self._flown_by_present(change)):
            text += f"; {crossing.text}"
        return Judged(accept(Code.FORMATION_ACCEPTED, text), lambda: self._await(change))

    def judge_on_ground(
        self,
        change: FormationChange,
        flying: Collection[PeerPacket],
        rft_enu_m: Sequence[Vector3],
        is_command: bool = False,
        check: Check = whole,
    ) -> Judged:
        """Of a change on the ground, where nothing moves. `flying` are the peers in the air; `check` as in flight."""
        if change == self._flown:
            return Judged(accept(Code.FORMATION_KNOWN, f"formation {change.number} is known"))
        if _is_flown(change, [other for other in flying if other.phase is FlightPhase.FORMATION]):
            return self._judge_flown(change)
        slots_enu_m = dict(change.slots_enu_m)
        refusal = (
            self._refusal(change, rft_enu_m, is_command)
            or self.limits.refusal_of_distance(slots_enu_m)
            or check(self.limits.airspace_steps(slots_enu_m, slots_enu_m, (), rft_enu_m))
        )
        if refusal is PENDING:
            return Judged(BEING_CHECKED)
        if refusal:
            return Judged(Answer(False, refusal.about("formation")))
        if flying:
            text = f"formation {change.number} is adopted here when the others fly it"
            return Judged(accept(Code.FORMATION_ACCEPTED, text))
        text = f"formation {change.number}, on the ground at once"
        return Judged(accept(Code.FORMATION_ACCEPTED, text), lambda: self._take_at_once(change))

    def _await(self, change: FormationChange) -> None:
        self._agreement.waiting = change

    def lacks(self, change: FormationChange, over_own: bool) -> bool:
        """Whether a change passed on by a leader is new here.

        With `over_own` also if another one waits, of any number: one that the leader does not have would not begin.
        """
        waiting = self._agreement.waiting
        if waiting is not None and change.number <= waiting.number and not over_own:
            return False
        return change != waiting and change.number != self._flown.number

    def is_settled(self, reference_s: float) -> bool:
        """Whether no change waits, and the formation flown has been reached."""
        return self._agreement.waiting is None and reference_s >= self._ends_s

    @property
    def _ends_s(self) -> float:
        """Mission time at which the formation flown is taken up, if nothing waits any more."""
        return self._flown.begins_s + self._flown.lasts_s + self._behind_s

    def to_pass_on(self, others: Iterable[PeerPacket]) -> FormationChange | None:
        """The change that a leader sends to its peers. `others` are all fresh peers.

        A waiting change is sent until it begins, so that all vehicles hold the same one; the formation flown is sent while a
        peer lacks it.
        """
        if self._agreement.waiting:
            return self._agreement.waiting
        number = self._flown.number
        lacked = any(number not in (other.slot.formation, other.slot.waiting) for other in others)
        return self._flown if lacked else None

    def update(
        self, now_s: float, reference_s: float, others: Collection[PeerPacket], in_formation: bool
    ) -> tuple[Notice, ...]:
        """Compute `flown` at this mission time; return the events. A path into the slot goes by the vehicle's own clock.

        `others` are the fresh peers that fly; `in_formation` is whether this vehicle forms or flies in formation.
        """
        events: tuple[Notice, ...] = ()
        agreement = self._agreement
        if reference_s < agreement.reference_s and agreement.falls_back(reference_s):
            events = self.restart()
        step_s, agreement.reference_s = max(0.0, reference_s - agreement.reference_s), reference_s
        if agreement.waiting and (due := agreement.take_due(reference_s)):
            events += self._begin(due, others, in_formation)
        flown, own_id = self._flown, self._own_id
        elapsed_s = reference_s - flown.begins_s - self._behind_s
        if self._movers and 0.0 < elapsed_s < flown.lasts_s:
            events += self._keep_pace(step_s, others)
            elapsed_s = reference_s - flown.begins_s - self._behind_s
        if elapsed_s > 0.0 and elapsed_s >= flown.lasts_s:
            motion = (self.slots_enu_m[own_id], ZERO3, ZERO3)
        else:
            motion = rest_to_rest(self._before_enu_m[own_id], self.slots_enu_m[own_id], elapsed_s, flown.lasts_s)
        if (pace := self._pace) < 1.0:
            motion = (motion[0], scaled(motion[1], pace), scaled(motion[2], pace * pace))
        moves_for_s = flown.lasts_s - elapsed_s if motion[1] != ZERO3 else 0.0
        if self._path:
            (delta, lasts_s), begun_s = self._path
            left_s = begun_s + lasts_s - now_s
            if left_s <= 0.0:
                self._path = None
                events += (Notice(Code.SLOT_REACHED, "has joined: it is in its slot"),)
            else:
                x, y, z = (plus(a, b) for a, b in zip(motion, delta(now_s - begun_s), strict=True))
                motion, moves_for_s = (x, y, z), max(moves_for_s, left_s)
        number = agreement.waiting.number if agreement.waiting else flown.number
        self.flown = FlownSlot(*motion, flown.number, number, moves_for_s)
        return events

    def _begin(
        self, waiting: FormationChange, others: Collection[PeerPacket], in_formation: bool
    ) -> tuple[Notice, ...]:
        """Begin the waiting change, or cancel it where a peer lacks it or an absent vehicle is back."""
        present = {o.sender.vehicle_id for o in others if o.phase in STREAMING} | (
            {self._own_id} if in_formation else set()
        )
        back = sorted(present & set(waiting.absent))
        held = [(o.sender.vehicle_id, o.slot.formation, o.slot.waiting) for o in others]
        reason = f"vehicle {back[0]} is back in formation" if back else self._agreement.lacked_by(waiting, held)
        if reason:
            return self._agreement.cancel(waiting, reason)
        text = f"formation {self._flown.number} -> {waiting.number}"
        self._take(waiting)
        self._movers = (present - {self._own_id}) if in_formation else set()
        return (Notice(Code.FORMATION_CHANGED, text),)

    def _keep_pace(self, step_s: float, others: Collection[PeerPacket]) -> tuple[Notice, ...]:
        """Slow down to a stop while a vehicle is silent that began this change with this one; the event where it begins."""
        heard = {other.sender.vehicle_id: other.phase in STREAMING for other in others}
        self._movers = {i for i in self._movers if heard.get(i, True)}  # one that left formation is only avoided
        silent = sorted(self._movers - heard.keys())
        if not silent and self._pace == 1.0:
            return ()
        before, share = self._pace, step_s / SLOWS_IN_S
        waits = silent and self._behind_s < WAITS_S
        self._pace = max(0.0, before - share) if waits else min(1.0, before + share)
        self._behind_s += (1.0 - self._pace) * step_s
        if before < 1.0 or not waits:
            return ()
        text = f"formation {self._flown.number} waits for vehicle {', '.join(map(str, silent))}, which is silent"
        return (Notice(Code.FORMATION_WAITS, text),)

    @property
    def reach_m(self) -> float:
        """Horizontal distance from the RFT to the outermost slot; during a change the larger of both formations."""
        return max(self._reach_before_m, self._reach_m) if self.flown.moves else self._reach_m

    def restart(self) -> tuple[Notice, ...]:
        """Mission time restarts, as with the next flight; the formation stays. Returns the event of a cancelled change."""
        self._flown, self._before_enu_m = _begun(self._flown), self.slots_enu_m
        self._movers, self._pace, self._behind_s = set(), 1.0, 0.0
        return self._agreement.restart()

    def start_path(self, path: Path, now_s: float) -> None:
        """Fly this path into the slot from now on."""
        self._path = (path, now_s)

    def end_path(self) -> None:
        """Drop the path: this vehicle is not in formation, or flies into its slot by the law alone."""
        self._path = None

    def _take(self, change: FormationChange) -> None:
        self._before_enu_m, self.slots_enu_m = self.slots_enu_m, dict(change.slots_enu_m)
        self._reach_before_m, self._reach_m = self._reach_m, reach_m(self.slots_enu_m.values())
        self._flown, self._agreement.waiting = change, None
        self._movers, self._pace, self._behind_s = set(), 1.0, 0.0

    def _take_at_once(self, change: FormationChange) -> None:
        """At its end: a vehicle outside formation does not move."""
        self._take(_begun(change))
        self._before_enu_m = self.slots_enu_m

    def _judge_flown(self, change: FormationChange) -> Judged:
        """Of the formation that others fly, which is adopted at once.

        The number is not compared: this vehicle may have received a newer change that was cancelled.
        """
        slots_enu_m = dict(change.slots_enu_m)
        refusal = self._refusal_of_form(change) or self.limits.refusal_of_distance(slots_enu_m)
        if refusal:
            return Judged(Answer(False, refusal.about("formation")))
        text = f"formation {change.number}, which the others fly"
        return Judged(accept(Code.FORMATION_ACCEPTED, text), lambda: self._take_at_once(change))

    def _refusal_of_form(self, change: FormationChange) -> Notice | None:
        ids = [vehicle_id for vehicle_id, _ in change.slots_enu_m]
        if sorted(ids) != sorted(self.slots_enu_m):
            text = f"slots for vehicles {sorted(ids)}; expected {sorted(self.slots_enu_m)}"
            return Notice(Code.SLOTS_INCOMPLETE, text)
        if not set(change.absent) < set(ids):
            text = f"absent vehicles {sorted(change.absent)}; expected some of {sorted(ids)}, not all"
            return Notice(Code.SLOTS_INCOMPLETE, text)
        too_new = self._agreement.refusal_if_too_new(change.number, self._flown.number)
        return too_new or self.limits.refusal_of_extent(dict(change.slots_enu_m))

    def _refusal(self, change: FormationChange, rft_enu_m: Sequence[Vector3], is_command: bool) -> Notice | None:
        """The refusal that does not depend on when it begins."""
        slots_enu_m = dict(change.slots_enu_m)
        refusal = (
            self._refusal_of_form(change)
            or self._agreement.refusal_if_too_old(change.number, self._flown.number, is_command)
            or self.limits.refusal_of_positions(slots_enu_m, rft_enu_m)
        )
        if refusal and refusal.code is Code.SLOT_OUTSIDE_FENCE:
            scale = self.limits.scale_inside(slots_enu_m, rft_enu_m)
            return refusal if scale is None else replace(refusal, accepts=(("scale", scale),))
        return refusal

    def _refusal_of_change(self, change: FormationChange, reference_s: float) -> Notice | None:
        """The refusal of its time, of its slots and of the speed from the formation flown now."""
        if refusal := self._agreement.refusal_of_time(change, reference_s):
            return refusal
        if not MIN_CHANGE_S <= change.lasts_s <= MAX_CHANGE_S:
            text = f"lasts {change.lasts_s:.1f} s; expected {MIN_CHANGE_S:g} to {MAX_CHANGE_S:g} s"
            return Notice(Code.CHANGE_TOO_LONG, text)
        if self._path:
            return Notice(Code.CHANGE_IN_PROGRESS, "this vehicle is not in its slot yet")
        if reference_s < self._ends_s:
            text = f"formation {self._flown.number} is still being taken up"
            return Notice(Code.CHANGE_IN_PROGRESS, text)
        before, after = self._flown_by_present(change)
        return self.limits.refusal_of_change(before, after, change.lasts_s) or (
            self.limits.refusal_of_distance(dict(change.slots_enu_m)) if change.absent else None
        )

    def _flown_by_present(self, change: FormationChange) -> tuple[dict[int, Vector3], dict[int, Vector3]]:
        """Slots before and after the change, of the vehicles that fly it."""
        after = {i: slot for i, slot in change.slots_enu_m if i not in change.absent}
        return {i: self.slots_enu_m[i] for i in after}, after

    def _airspace_steps(
        self, change: FormationChange, reference_s: float, rft_enu_m: Sequence[Vector3]
    ) -> Steps[Notice | None]:
        """The refusal where a slot, or a path to it while the change lasts, meets an obstacle or leaves the polygon."""
        arrives_in_s = change.begins_s + change.lasts_s - reference_s
        on_the_way = rft_enu_m[: ceil(arrives_in_s) + 1]
        return self.limits.airspace_steps(self.slots_enu_m, dict(change.slots_enu_m), on_the_way, rft_enu_m)


def _is_flown(change: FormationChange, others: Iterable[PeerPacket]) -> bool:
    return any(other.slot.formation == change.number for other in others)


def _begun(change: FormationChange) -> FormationChange:
    """The change as flown since mission time 0."""
    return FormationChange(change.number, change.slots_enu_m, 0.0, 0.0)
