"""Which RFT a vehicle that may lead flies by when it leads: its file's, or one that a command brought.

A change begins at a time of the fleet's that all count, and only where every flying vehicle that may lead has it waiting: one
that missed the command would lead elsewhere. So it is the same RFT, whoever leads, also during the hand-over.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass

from companion.core.formation import Place
from companion.core.hand_over import HandOverLimits, handed_over
from companion.core.pursuit import Pursuit, PursuitLimits, can_keep
from companion.core.reference import ReferenceTrajectory
from companion.core.reference_clock import FALLS_BACK_S
from companion.core.targets import Targets
from companion.types import (
    MAX_EPOCHS_AHEAD,
    ZERO3,
    Described,
    FlightPhase,
    HeldReference,
    PeerPacket,
    ReceivedTarget,
    ReferenceChange,
    Role,
    Vector3,
)

LATEST_S = 60.0  # ahead of the fleet's time
LOOKS_AHEAD_S = 120  # for what a formation must keep about the RFT, wherever that leads
LED_LATELY_S = 2.0  # so long counts what a leader said that is heard no more: another is to take over from it


@dataclass(frozen=True, slots=True)
class LiveReference:
    """An RFT that follows a target; see TargetReference in `config/reference.py`."""

    start_enu_m: Vector3
    name: str
    offset_enu_m: Vector3
    follows_altitude: bool
    max_age_s: float
    limits: PursuitLimits

    def goal(self, position_enu_m: Vector3 | None, velocity_enu_m_s: Vector3) -> tuple[Vector3 | None, Vector3]:
        """Where R is to be, and how it moves, for a target there; without its place, how it moves."""
        vx, vy, vz = velocity_enu_m_s
        velocity = (vx, vy, vz if self.follows_altitude else 0.0)
        if position_enu_m is None:
            return None, velocity
        (x, y, z), (dx, dy, dz) = position_enu_m, self.offset_enu_m
        return (x + dx, y + dy, z + dz if self.follows_altitude else self.start_enu_m[2]), velocity


Rft = ReferenceTrajectory | LiveReference
Read = Callable[[Described, Mapping[int, Vector3]], Rft]
"""From a description and the slots to be flown about it to a checked RFT. Raises ValueError with the reason."""
Flown = ReferenceTrajectory | Pursuit
"""In the fleet's own time."""


class ReferencePlan:
    """One vehicle's. `events` tells of changes and of targets that fall silent, until somebody takes it."""

    def __init__(self, first: Rft, read: Read, limits: HandOverLimits) -> None:
        """`first` is the file's; `read` checks what a command brings."""
        self._read = read
        self._limits = limits
        self._targets = Targets()
        self._change: ReferenceChange | None = None  # that brought what is flown; None: the file did
        self._waiting: tuple[ReferenceChange, Rft] | None = None
        self._rft = first
        self._flown = _begun_anew(first)
        self._begun_s = 0.0  # when what is flown began
        self._reference_s = 0.0
        self._led_by: tuple[int, HeldReference] | None = None  # who leads in formation, and by which RFT
        self._led_s = 0.0
        self.target_age_s: float | None = None  # None where none is followed, or none was heard
        self.events: list[str] = []

    @property
    def held(self) -> HeldReference:
        flown = self._change.number if self._change else 0
        return HeldReference(flown, self._waiting[0].number if self._waiting else flown, self._begun_s)

    @property
    def rejected(self) -> Mapping[str, int]:
        return self._targets.rejected

    def at(self, reference_s: float) -> Place:
        """R and r'' at this time of the fleet's; where a target is followed, now."""
        return self._flown.place if isinstance(self._flown, Pursuit) else self._flown(reference_s)

    def places_enu_m(self, reference_s: float) -> list[Vector3]:
        """r from this time of the fleet's on, one a second for two minutes; where a target is followed, now alone.

        Likewise of the RFT that is to come, where one is.
        """
        times_s = [reference_s + ahead_s for ahead_s in range(LOOKS_AHEAD_S)]
        places_enu_m = []
        if self._waiting:
            change, rft = self._waiting
            places_enu_m = _places_enu_m(_begun_anew(rft), [max(0.0, t - change.begins_s) for t in times_s])
        return _places_enu_m(self._flown, times_s) + places_enu_m

    def obey(
        self,
        change: ReferenceChange,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
        others: Iterable[PeerPacket],
        here_enu_m: Vector3,
    ) -> tuple[bool, str]:
        """(accepted, why not or what happens now). `here_enu_m` is where this vehicle has the fleet, by its own place."""
        if self._has(change):
            return True, f"reference {change.number} is known"
        theirs = HeldReference(change.number, begun_s=change.begins_s)
        late = any(other.reference and _are_one(other.reference, theirs) for other in others)
        if refusal := self._refusal(change, reference_s, late):
            return False, f"reference: {refusal}"
        try:
            rft = self._read(change.reference, slots_enu_m)
            if late:
                self._take(change, rft, _joined(rft, change.begins_s, here_enu_m))
                return True, f"reference {change.number}, which the leader flies"
            self._begun(change, rft, slots_enu_m)
        except ValueError as error:
            return False, f"reference: {error}"
        self._waiting = (change, rft)
        return True, f"reference {change.number} begins in {change.begins_s - reference_s:.1f} s"

    def update(
        self,
        now_s: float,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
        others: Collection[PeerPacket],
        heard: Iterable[ReceivedTarget],
    ) -> None:
        """Once a tick. `others` are all that are heard of and fly, `slots_enu_m` the formation's, `heard` is of targets."""
        self._hear_leader(now_s, others)
        live = [rft for rft in (self._rft, self._waiting and self._waiting[1]) if isinstance(rft, LiveReference)]
        self._targets.fold(heard, [rft.name for rft in live])
        if reference_s < self._reference_s - FALLS_BACK_S:
            self._begin_anew()
            self._reference_s = reference_s
        if self._waiting is not None and reference_s >= self._waiting[0].begins_s:
            self._begin(*self._waiting, slots_enu_m, others)
        if isinstance(self._flown, Pursuit) and isinstance(self._rft, LiveReference):
            self._follow(self._flown, self._rft, now_s, reference_s, slots_enu_m)
        self._reference_s = max(self._reference_s, reference_s)  # it is put right, to and fro, by milliseconds

    def missing(self, now_s: float) -> str:
        """Why this vehicle must not take the lead just now: it has another RFT than who led last; "" where it has that one.

        What that one said last may be of just before a change that both have.
        """
        if self._led_by is None or now_s - self._led_s > LED_LATELY_S:
            return ""
        leader_id, theirs = self._led_by
        held = self.held
        if _are_one(theirs, held) or held.flown == _to_come(theirs) or theirs.flown == _to_come(held):
            return ""
        return (
            f"vehicle {leader_id} flies reference {theirs.flown} since {theirs.begun_s:.1f} s of the fleet's time,"
            f" this one {held.flown} since {held.begun_s:.1f} s"
        )

    def _hear_leader(self, now_s: float, others: Iterable[PeerPacket]) -> None:
        for other in others:
            if other.reference and other.role is Role.LEADER and other.phase is FlightPhase.FORMATION:
                self._led_by, self._led_s = (other.vehicle_id, other.reference), now_s

    def _has(self, change: ReferenceChange) -> bool:
        if self._waiting and change == self._waiting[0]:
            return True
        return change == self._change and change.begins_s == self._begun_s

    def _begin_anew(self) -> None:
        """After a landing the fleet's time does, and with it the RFT that was flown last."""
        if self._waiting:
            self.events.append(f"reference {self._waiting[0].number} does not begin: the fleet's time begins anew")
        self._waiting, self._begun_s = None, 0.0
        self._flown, self.target_age_s = _begun_anew(self._rft), None

    def _refusal(self, change: ReferenceChange, reference_s: float, late: bool) -> str | None:
        flown = self.held.flown
        if self._waiting:
            return f"{self._waiting[0].number} is still to begin"
        if not late and not flown < change.number <= flown + MAX_EPOCHS_AHEAD:
            return f"number {change.number} is not newer than {flown}"
        if not late and not reference_s < change.begins_s <= reference_s + LATEST_S:
            return f"begins at {change.begins_s:.1f} s of the fleet's time, which is {reference_s:.1f} s now"
        return None

    def _begin(
        self, change: ReferenceChange, rft: Rft, slots_enu_m: Mapping[int, Vector3], others: Iterable[PeerPacket]
    ) -> None:
        self._waiting = None
        held = [(o.vehicle_id, o.reference) for o in others if o.reference]
        lacking = [i for i, theirs in held if change.number not in (theirs.flown, theirs.waiting)]
        if lacking:
            self.events.append(f"reference {change.number} does not begin: vehicle {min(lacking)} does not have it")
            return
        try:
            flown, how = self._begun(change, rft, slots_enu_m)
        except ValueError as error:
            self.events.append(f"reference {change.number} does not begin: {error}")
            return
        self.events.append(f"reference {self.held.flown} -> {change.number} ({how})")
        self._take(change, rft, flown)

    def _begun(self, change: ReferenceChange, rft: Rft, slots_enu_m: Mapping[int, Vector3]) -> tuple[Flown, str]:
        """What is flown from then on, and how it is gone over to. Raises ValueError where it cannot be."""
        old, box = self.at(change.begins_s), self._limits.room(slots_enu_m.values())
        if isinstance(rft, LiveReference):
            if not can_keep(old, rft.limits, box):
                raise ValueError("the fleet is too fast or too near the fence to follow a target within these limits")
            return Pursuit(rft.limits, old), f"follows target {rft.name}"
        found = handed_over(old, rft, change.begins_s, self._limits, box)
        if found is None:
            raise ValueError(
                "no hand-over to it keeps all vehicles inside the fence and within the limits of speed and tilt"
            )
        flown, lasts_s = found
        return flown, f"hand-over of {lasts_s:.1f} s"

    def _take(self, change: ReferenceChange, rft: Rft, flown: Flown) -> None:
        self._change, self._rft, self._flown = change, rft, flown
        self._begun_s, self.target_age_s = change.begins_s, None
        self._reference_s = max(self._reference_s, change.begins_s)  # a target is followed from then on

    def _follow(
        self,
        pursuit: Pursuit,
        live: LiveReference,
        now_s: float,
        reference_s: float,
        slots_enu_m: Mapping[int, Vector3],
    ) -> None:
        target = self._targets.newest(live.name)
        age_s, before_s = now_s - target.measured_s if target else None, self.target_age_s
        self._tell_silence(live, before_s, age_s)
        self.target_age_s = age_s
        goal, velocity = None, ZERO3
        if target and age_s is not None and age_s <= live.max_age_s:
            goal, velocity = live.goal(target.position_at(now_s), target.sample.velocity_enu_m_s)
        box = self._limits.room(slots_enu_m.values())
        pursuit.advance(reference_s - self._reference_s, goal, velocity, box)

    def _tell_silence(self, live: LiveReference, before_s: float | None, age_s: float | None) -> None:
        heard = age_s is not None and age_s <= live.max_age_s
        was_heard = before_s is not None and before_s <= live.max_age_s
        if heard and not was_heard:
            self.events.append(f"target {live.name} is heard")
        elif was_heard and not heard:
            self.events.append(f"target {live.name} is silent for {live.max_age_s:g} s: the reference comes to rest")


def _places_enu_m(flown: Flown, times_s: Iterable[float]) -> list[Vector3]:
    if isinstance(flown, Pursuit):
        return [flown.place.position_enu_m]
    return [flown(time_s).position_enu_m for time_s in times_s]


def _to_come(held: HeldReference) -> int | None:
    return held.waiting if held.waiting != held.flown else None


def _are_one(a: HeldReference, b: HeldReference) -> bool:
    return a.flown == b.flown and a.begun_s == b.begun_s


def _begun_anew(rft: Rft) -> Flown:
    return Pursuit(rft.limits, Place(rft.start_enu_m, ZERO3)) if isinstance(rft, LiveReference) else rft


def _joined(rft: Rft, begins_s: float, here_enu_m: Vector3) -> Flown:
    """What others fly already, without the way they came to it; a target's place is about where the fleet is."""
    if isinstance(rft, LiveReference):
        return Pursuit(rft.limits, Place(here_enu_m, ZERO3))
    return lambda reference_s: rft(max(0.0, reference_s - begins_s))
