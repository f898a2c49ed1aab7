"""The RFT of a vehicle that may lead: configured in its vehicle file, or changed by command.

A change begins at a mission time, and only if every flying vehicle that may lead holds it: one that missed it would lead
elsewhere. So the RFT is the same whichever vehicle is leader, also during a hand-over to another RFT.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from msgspec import json

from companion.core.paced import BEING_CHECKED, PENDING, PacedChecks
from companion.core.reference.agreement import Agreement
from companion.core.reference.blend import BlendLimits, ReferenceTrajectory, blending
from companion.core.reference.target import TargetLimits, TargetPursuit, Targets, can_keep
from companion.types.commands import Described, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationState, HeldReference
from companion.types.notices import Answer, Code, Judged, Notice, accept
from companion.types.peers import PeerPacket, ReceivedTarget
from companion.types.steps import Steps, first_steps
from companion.types.values import ZERO3, Vector3

LEADER, FORMATION = Role.LEADER, FlightPhase.FORMATION  # member lookup of an enum is slow
SETTLED_S = 0.5  # before a change begins it stays: longer than any packet of a peer counts
LOOK_AHEAD_S = 120  # a formation must keep its limits along the RFT for this time ahead
STEPS_AT_ONCE = 12  # steps at once, when the hand-over that is searched begins now
LEADER_VALID_S = 2.0  # the last packet of a lost leader counts for this time: its successor needs the same RFT


@dataclass(frozen=True, slots=True)
class LiveReference:
    """An RFT that follows a target; see TargetReference in `config/reference/target.py`."""

    start_enu_m: Vector3
    name: str
    offset_enu_m: Vector3
    follows_altitude: bool
    max_age_s: float
    limits: TargetLimits

    def goal(self, position_enu_m: Vector3 | None, velocity_enu_m_s: Vector3) -> tuple[Vector3 | None, Vector3]:
        """Wanted position and velocity of R for this target state; the position is None without one of the target."""
        vx, vy, vz = velocity_enu_m_s
        velocity = (vx, vy, vz if self.follows_altitude else 0.0)
        if position_enu_m is None:
            return None, velocity
        (x, y, z), (dx, dy, dz) = position_enu_m, self.offset_enu_m
        return (x + dx, y + dy, z + dz if self.follows_altitude else self.start_enu_m[2]), velocity


Rft = ReferenceTrajectory | LiveReference
Read = Callable[[Described, Mapping[int, Vector3]], Steps[Rft | Notice]]
"""(description, slots) -> checked RFT, or its refusal."""
RefusalOfSlots = Callable[[Described | None, Mapping[int, Vector3]], Steps[str | None]]
"""(description, None for the configured RFT; slots) -> why the law cannot fly these slots with it."""
Flown = ReferenceTrajectory | TargetPursuit
"""A function of mission time, or a pursuit that is advanced tick by tick."""
HandedOver = tuple[Flown, str]
"""An RFT with its hand-over, and a text for the event."""
Handed = tuple[Flown, Mapping[int, Vector3], HandedOver]
"""Old RFT, slots, hand-over."""


class ReferencePlan:
    """The RFT flown, the change that waits, and the RFT of the last leader."""

    def __init__(
        self, first: Rft, described: Described | None, read: Read, refusal_of_slots: RefusalOfSlots, limits: BlendLimits
    ) -> None:
        """`first` is the configured RFT, `described` as a command would bring it, None where none could.

        `read` checks a commanded one, `refusal_of_slots` other slots for one.
        """
        self.described = described  # the RFT flown
        self._read = read
        self._refusal_of_slots = refusal_of_slots
        self._limits = limits
        self._targets = Targets()
        self._change: ReferenceChange | None = None  # the change that brought the RFT flown; None: the configured RFT
        self._agreement: Agreement[ReferenceChange] = Agreement("reference", Code.REFERENCE_CANCELLED)
        self._rft = self._waiting_rft = first
        self._flown = _from_start(first)
        self._handed: Handed | None = None  # of the change that waits
        self.flown_count = 0  # number of RFTs flown since the agent started
        self._begun_s = 0.0  # mission time at which the RFT flown began
        self._led_by: tuple[int, HeldReference] | None = None  # leader in formation, and its RFT
        self._led_s = 0.0
        self.target_age_s: float | None = None  # None without a target, or before its first sample

    @property
    def held(self) -> HeldReference:
        flown, waiting = self._change.number if self._change else 0, self._agreement.waiting
        return HeldReference(flown, waiting.number if waiting else flown, self._begun_s)

    @property
    def rejected(self) -> Mapping[str, int]:
        return self._targets.rejected

    def at(self, reference_s: float) -> FormationState:
        """R and r'' at this mission time; of a followed target, now."""
        return self._flown.state if isinstance(self._flown, TargetPursuit) else self._flown(reference_s)

    def positions_enu_m(self, reference_s: float) -> list[Vector3]:
        """r from this mission time on, once a second for LOOK_AHEAD_S; of a followed target, now alone.

        Those of a waiting RFT follow.
        """
        times_s = [reference_s + ahead_s for ahead_s in range(LOOK_AHEAD_S)]
        waiting_enu_m = []
        if change := self._agreement.waiting:
            since_s = [max(0.0, time_s - change.begins_s) for time_s in times_s]
            waiting_enu_m = _positions_enu_m(_from_start(self._waiting_rft), since_s)
        return _positions_enu_m(self._flown, times_s) + waiting_enu_m

    def refusal_of_slots(self, slots_enu_m: Mapping[int, Vector3]) -> Steps[str | None]:
        """Why the law cannot fly these slots with the RFT flown, or with the one that waits."""
        waiting = self._agreement.waiting
        refusal = yield from self._refusal_of_slots(self._change.reference if self._change else None, slots_enu_m)
        if refusal is None and waiting:
            refusal = yield from self._refusal_of_slots(waiting.reference, slots_enu_m)
        return refusal

    def judge(
        self,
        change: ReferenceChange,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
        others: Iterable[PeerPacket],
        fleet_enu_m: Vector3,
        in_formation: bool = False,
        checks: PacedChecks | None = None,
    ) -> tuple[Judged, list[Vector3]]:
        """The verdict, and r of an accepted reference with its hand-over, once a second; empty for a followed target.

        Nothing is changed yet. `fleet_enu_m` is r of the fleet, derived from this vehicle's own position. `in_formation`: this
        vehicle forms or flies in formation, where mission time runs. A change replaces one that waits.
        `checks` do the expensive part, after all other refusals: while the answer is BEING_CHECKED, ask again in the next tick.
        """
        if self._has(change):
            return Judged(accept(Code.REFERENCE_KNOWN, f"reference {change.number} is known")), []
        theirs = HeldReference(change.number, begun_s=change.begins_s)
        late = any(other.reference and _is_same(other.reference, theirs) for other in others)
        if refusal := self._refusal(change, reference_s, late, in_formation):
            return Judged(Answer(False, refusal.about("reference"))), []
        slots = tuple(sorted(slots_enu_m.items()))
        key = (json.encode(change), slots, self.flown_count, late)
        found = (checks or PacedChecks()).ask(key, lambda: self._checked(change, dict(slots), late))
        if found is PENDING:
            return Judged(BEING_CHECKED), []
        if isinstance(found, Notice):
            return Judged(Answer(False, found.about("reference"))), []
        rft, handed = found
        if handed is None:
            text = f"reference {change.number}, which the leader flies"
            return Judged(accept(Code.REFERENCE_ACCEPTED, text), lambda: self._join(change, rft, fleet_enu_m)), []
        text = f"reference {change.number} begins in {change.begins_s - reference_s:.1f} s"
        verdict = Judged(
            accept(Code.REFERENCE_ACCEPTED, text), lambda: self._await(change, rft, (self._flown, dict(slots), handed))
        )
        if isinstance(handed[0], TargetPursuit):
            return verdict, []
        return verdict, _positions_enu_m(handed[0], [change.begins_s + ahead_s for ahead_s in range(LOOK_AHEAD_S)])

    def _join(self, change: ReferenceChange, rft: Rft, fleet_enu_m: Vector3) -> None:
        """Take the RFT that the leader flies already."""
        self._take(change, rft, _joined(rft, change.begins_s, fleet_enu_m))
        self._agreement.waiting = None

    def _await(self, change: ReferenceChange, rft: Rft, handed: Handed) -> None:
        self._agreement.waiting, self._waiting_rft, self._handed = change, rft, handed

    def _checked(
        self, change: ReferenceChange, slots_enu_m: Mapping[int, Vector3], late: bool
    ) -> Steps[tuple[Rft, HandedOver | None] | Notice]:
        """The RFT of a change and, unless others fly it already, its hand-over; or why it is refused."""
        try:
            rft = yield from self._read(change.reference, slots_enu_m)
            if isinstance(rft, Notice):
                return rft
            yield
            return rft, (None if late else (yield from self._handing_over(change, rft, slots_enu_m)))
        except ValueError as error:
            return Notice(Code.REFERENCE_INVALID, str(error))

    def update(
        self,
        now_s: float,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
        others: Collection[PeerPacket],
        targets: Iterable[ReceivedTarget],
    ) -> tuple[Notice, ...]:
        """Once a tick, with the fresh peers that fly, the slots of the formation and new target samples; returns the events."""
        self._note_leader(now_s, others)
        agreement = self._agreement
        followed = (self._rft, self._waiting_rft) if agreement.waiting else (self._rft,)
        self._targets.fold(targets, [rft.name for rft in followed if isinstance(rft, LiveReference)])
        events: tuple[Notice, ...] = ()
        if agreement.falls_back(reference_s):
            events = self._restart()
            agreement.reference_s = reference_s
        if due := agreement.take_due(reference_s):
            events += self._begin(due, slots_enu_m, others)
        if isinstance(self._flown, TargetPursuit) and isinstance(self._rft, LiveReference):
            events += self._follow(self._flown, self._rft, now_s, reference_s, slots_enu_m)
        agreement.reference_s = max(agreement.reference_s, reference_s)  # corrections by milliseconds do not count
        return events

    def missing(self, now_s: float) -> Notice | None:
        """Why this vehicle must not become leader now: its RFT differs from the last leader's; None where it is the same.

        The leader's last packet may date from just before a change that both hold.
        """
        if self._led_by is None or now_s - self._led_s > LEADER_VALID_S:
            return None
        leader_id, theirs = self._led_by
        held = self.held
        if _is_same(theirs, held) or held.flown == _next(theirs) or theirs.flown == _next(held):
            return None
        return Notice(
            Code.REFERENCE_DIFFERS,
            f"vehicle {leader_id} flies reference {theirs.flown} since mission time {theirs.begun_s:.1f} s,"
            f" this vehicle {held.flown} since {held.begun_s:.1f} s",
        )

    def _note_leader(self, now_s: float, others: Iterable[PeerPacket]) -> None:
        for other in others:
            if other.reference and other.role is LEADER and other.phase is FORMATION:
                self._led_by, self._led_s = (other.sender.vehicle_id, other.reference), now_s

    def _has(self, change: ReferenceChange) -> bool:
        if change == self._agreement.waiting:
            return True
        return change == self._change and change.begins_s == self._begun_s

    def _restart(self) -> tuple[Notice, ...]:
        """Mission time restarted after a landing, and with it the RFT flown last. Cancels a waiting change."""
        self._begun_s = 0.0
        self._flown, self.target_age_s = _from_start(self._rft), None
        self.flown_count += 1
        return self._agreement.restart()

    def _refusal(self, change: ReferenceChange, reference_s: float, late: bool, in_formation: bool) -> Notice | None:
        flown, agreement = self.held.flown, self._agreement
        # In the last moment one vehicle would begin the change that waits, and another one this change.
        if agreement.waiting and in_formation and agreement.waiting.begins_s - reference_s < SETTLED_S:
            return Notice(Code.CHANGE_IN_PROGRESS, f"{agreement.waiting.number} is about to begin")
        if refusal := agreement.refusal_if_too_new(change.number, flown):
            return refusal
        if late:
            return None
        too_old = agreement.refusal_if_too_old(change.number, flown, is_command=True)
        return too_old or agreement.refusal_of_time(change, reference_s)

    def _begin(
        self, change: ReferenceChange, slots_enu_m: Mapping[int, Vector3], others: Iterable[PeerPacket]
    ) -> tuple[Notice, ...]:
        """Begin a change that is due, or cancel it where a peer that may lead lacks it or no hand-over is possible."""
        held = [(o.sender.vehicle_id, o.reference.flown, o.reference.waiting) for o in others if o.reference]
        if lacking := self._agreement.lacked_by(change, held):
            return self._agreement.cancel(change, lacking)
        try:
            flown, how = self._handed_over(change, slots_enu_m)
        except ValueError as error:
            return self._agreement.cancel(change, str(error))
        text = f"reference {self.held.flown} -> {change.number} ({how})"
        self._take(change, self._waiting_rft, flown)
        return (Notice(Code.REFERENCE_CHANGED, text),)

    def _handed_over(self, change: ReferenceChange, slots_enu_m: Mapping[int, Vector3]) -> HandedOver:
        """The hand-over of the change that waits. Raises ValueError where none is possible, or none is found at once.

        It was found when the change was checked, unless a target is followed or the slots are others now.
        """
        if self._handed and not isinstance(self._flown, TargetPursuit):
            flown, slots, handed = self._handed
            if flown is self._flown and slots == slots_enu_m:
                return handed
        return first_steps(self._handing_over(change, self._waiting_rft, slots_enu_m), STEPS_AT_ONCE)

    def _handing_over(self, change: ReferenceChange, rft: Rft, slots_enu_m: Mapping[int, Vector3]) -> Steps[HandedOver]:
        """The RFT with its hand-over. Raises ValueError where no hand-over is possible."""
        old = self.at(change.begins_s)
        if isinstance(rft, LiveReference):
            if not can_keep(old, rft.limits, self._limits.room(slots_enu_m.values())):
                raise ValueError(
                    "the fleet is too fast, or too near the fence or an obstacle, to follow a target within these limits"
                )
            return TargetPursuit(rft.limits, old), f"follows target {rft.name}"
        found = yield from blending(old, rft, change.begins_s, self._limits, list(slots_enu_m.values()))
        if found is None:
            raise ValueError(
                "no hand-over to it keeps all vehicles inside the fence and within the limits of speed and tilt"
            )
        flown, lasts_s = found
        return flown, f"hand-over of {lasts_s:.1f} s"

    def _take(self, change: ReferenceChange, rft: Rft, flown: Flown) -> None:
        self._change, self._rft, self._flown, self.described = change, rft, flown, change.reference
        self.flown_count += 1
        self._begun_s, self.target_age_s = change.begins_s, None
        # A target is followed from then on.
        self._agreement.reference_s = max(self._agreement.reference_s, change.begins_s)

    def _follow(
        self,
        pursuit: TargetPursuit,
        live: LiveReference,
        now_s: float,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
    ) -> tuple[Notice, ...]:
        """Advance the pursuit by one tick; return the event where the target is received again or lost."""
        target = self._targets.newest(live.name)
        age_s, before_s = now_s - target.measured_s if target else None, self.target_age_s
        self.target_age_s = age_s
        goal, velocity = None, ZERO3
        if target and age_s is not None and age_s <= live.max_age_s:
            goal, velocity = live.goal(target.position_at(now_s), target.sample.velocity_enu_m_s)
        room = self._limits.room(slots_enu_m.values())
        pursuit.advance(reference_s - self._agreement.reference_s, goal, velocity, room)
        return _target_events(live, before_s, age_s)


def _target_events(live: LiveReference, before_s: float | None, age_s: float | None) -> tuple[Notice, ...]:
    """The event where a target becomes fresh or stale; `before_s` is its age in the last tick."""
    is_fresh = age_s is not None and age_s <= live.max_age_s
    was_fresh = before_s is not None and before_s <= live.max_age_s
    if is_fresh and not was_fresh:
        return (Notice(Code.TARGET_RECEIVED, f"target {live.name} is received"),)
    if was_fresh and not is_fresh:
        text = f"target {live.name} is silent for {live.max_age_s:g} s: the reference comes to rest"
        return (Notice(Code.TARGET_LOST, text),)
    return ()


def _positions_enu_m(flown: Flown, times_s: Iterable[float]) -> list[Vector3]:
    if isinstance(flown, TargetPursuit):
        return [flown.state.position_enu_m]
    return [flown(time_s).position_enu_m for time_s in times_s]


def _next(held: HeldReference) -> int | None:
    return held.waiting if held.waiting != held.flown else None


def _is_same(a: HeldReference, b: HeldReference) -> bool:
    return a.flown == b.flown and a.begun_s == b.begun_s


def _from_start(rft: Rft) -> Flown:
    return TargetPursuit(rft.limits, FormationState(rft.start_enu_m, ZERO3)) if isinstance(rft, LiveReference) else rft


def _joined(rft: Rft, begins_s: float, fleet_enu_m: Vector3) -> Flown:
    """The RFT that others fly already, without their hand-over to it. A pursuit begins at the position of the fleet."""
    if isinstance(rft, LiveReference):
        return TargetPursuit(rft.limits, FormationState(fleet_enu_m, ZERO3))
    return lambda reference_s: rft(max(0.0, reference_s - begins_s))
