"""What of the vehicles' reports can be true. A report that cannot costs its own vehicle, not the commands to the others. Pure.

Bounds follow from the fleet file: its fence, and for a slot what a vehicle itself accepts of a formation. A value beyond them
is replaced, and a `Doubt` names it. Its vehicle gets each command like the others, and decides by what it knows itself.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from math import hypot
from typing import Any, NamedTuple

from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.ground.changes import AHEAD_S, TIMES_AGREE_S, fleet_time_s, free_slot, is_free
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code, Notice
from companion.types.status import NO_STATE_AGE_S, Status
from companion.types.values import MAX_COORDINATE_M, MAX_MISSION_S, Vector3

LEAST_BEYOND_M = 100.0  # a vehicle may be so far outside a small fence: a pilot flies it, or its origin is not exact
SLOT_ROUNDING_M = 0.001  # a status has its slot to 0.1 mm


class Box(NamedTuple):
    """Between two corners, ENU in metres."""

    low: Vector3
    high: Vector3

    def contains(self, point: Vector3) -> bool:
        return all(low <= x <= high for low, x, high in zip(self.low, point, self.high, strict=True))

    def __str__(self) -> str:
        return ", ".join(f"{low:.0f} to {high:.0f}" for low, high in zip(self.low, self.high, strict=True)) + " m"


@dataclass(frozen=True, slots=True)
class Doubt:
    """A value that a vehicle reports and that cannot be true."""

    vehicle_id: int
    field: str
    found: str
    expected: str

    @property
    def notice(self) -> Notice:
        """The field, what it is and what was expected."""
        return Notice(
            Code.REPORT_IMPLAUSIBLE, f"reports {self.field} {self.found}; expected {self.expected}: it is not believed"
        )

    def __str__(self) -> str:
        return f"vehicle {self.vehicle_id} {self.notice.text}"


class Belief(NamedTuple):
    """The reports as far as they can be true, and what cannot.

    `unsure` vehicles may fly another slot than that in here, or are on their way to it; `reach_m` is how far from the reference
    the slot of each may be.
    """

    statuses: list[Status]
    doubts: tuple[Doubt, ...]
    unsure: frozenset[int]
    reach_m: dict[int, float]


def believed(statuses: Iterable[Status], fleet: FleetConfig) -> Belief:
    """The reports of a fleet, with what is beyond the bounds replaced: a position by none, a slot by one that is free."""
    reports = list(statuses)
    time_s, near, slots = fleet_time_s(reports), near_the_fence(fleet), {m.id: m.slot_enu_m for m in fleet.vehicles}
    doubts = [doubt for status in reports for doubt in _doubts(status, fleet, slots, near, time_s)]
    flown, wrong = flown_formation(reports), {doubt.vehicle_id for doubt in doubts if doubt.field == SLOT}
    apart = [s for s in reports if s.formation.slot.formation != flown and s.agent.vehicle_id not in wrong]
    sure = [s for s in reports if s.formation.slot.formation == flown and s.agent.vehicle_id not in wrong]
    taken = [status.formation.slot.position_enu_m for status in sure]
    for status in apart:
        if is_free(slot := status.formation.slot.position_enu_m, taken, fleet):
            taken.append(slot)
        else:
            expected = f"one that is free in formation {flown}, which the others fly"
            doubts.append(Doubt(status.agent.vehicle_id, SLOT, _metres(slot), expected))
    of_field = {field: {doubt.vehicle_id for doubt in doubts if doubt.field == field} for field in FIELDS}
    result = []
    for status in reports:
        vehicle_id = status.agent.vehicle_id
        if vehicle_id in of_field[SLOT]:
            taken.append(free_slot(slots.get(vehicle_id), taken, fleet))
            status = _with_formation(status, slot=replace(status.formation.slot, position_enu_m=taken[-1]))
        result.append(_without(status, {field for field, ids in of_field.items() if vehicle_id in ids}))
    moving = {status.agent.vehicle_id for status in reports if status.formation.slot.moves}
    unsure = frozenset(of_field[SLOT] | {status.agent.vehicle_id for status in apart} | moving)
    reach_m = max(hypot(*slot) for slot in (*slots.values(), *taken))
    return Belief(result, tuple(doubts), unsure, dict.fromkeys(unsure, reach_m))


def _without(status: Status, fields: Collection[str]) -> Status:
    """The report without these values."""
    if POSITION in fields:
        status = replace(status, motion=replace(status.motion, state_age_s=NO_STATE_AGE_S))
    if REFERENCE in fields:
        status = _with_formation(status, reference_enu_m=None)
    return _with_formation(status, reference_s=0.0) if TIME in fields else status


def flown_formation(reports: Collection[Status]) -> int:
    """The number of the formation that most vehicles in formation fly, or most of all; of two as many, that of a leader."""
    flying = [status for status in reports if status.phase is FlightPhase.FORMATION] or reports
    counted = Counter(status.formation.slot.formation for status in flying)
    led = {status.formation.slot.formation for status in flying if status.leadership.role is Role.LEADER}
    return max(counted, key=lambda number: (counted[number], number in led, -number), default=0)


def doubts_of(statuses: Collection[Status], fleet: FleetConfig) -> tuple[Doubt, ...]:
    """What the operator is told of these reports."""
    return believed(statuses, fleet).doubts


POSITION, SLOT, REFERENCE, TIME = "position_enu_m", "slot", "reference_enu_m", "reference_s"
FIELDS = (POSITION, SLOT, REFERENCE, TIME)


def near_the_fence(fleet: FleetConfig) -> Box:
    """The fence with as much room around it as it is wide, at least LEAST_BEYOND_M: where a vehicle may be at all."""
    low, high = fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m
    beyond_m = max(LEAST_BEYOND_M, hypot(high[0] - low[0], high[1] - low[1]))

    def grown(corner: Vector3, by_m: float) -> Vector3:
        x, y, z = (max(-MAX_COORDINATE_M, min(component + by_m, MAX_COORDINATE_M)) for component in corner)
        return x, y, z

    return Box(grown(low, -beyond_m), grown(high, beyond_m))


def _doubts(
    status: Status, fleet: FleetConfig, slots_enu_m: Mapping[int, Vector3], near: Box, time_s: float
) -> Iterable[Doubt]:
    vehicle_id, flown = status.agent.vehicle_id, status.formation
    places = {
        POSITION: status.motion.position_enu_m if status.motion.is_known else None,
        REFERENCE: flown.reference_enu_m,
    }
    for field, place in places.items():
        if place is not None and not near.contains(place):
            yield Doubt(vehicle_id, field, _metres(place), f"x, y, z of {near}, by the fence")
    if expected := _expected_slot(status, fleet, slots_enu_m.get(vehicle_id)):
        yield Doubt(vehicle_id, SLOT, _metres(flown.slot.position_enu_m), expected)
    latest_s = MAX_MISSION_S - AHEAD_S
    if not 0.0 <= flown.reference_s <= latest_s:
        yield Doubt(vehicle_id, TIME, f"{flown.reference_s:g} s", f"0 to {latest_s:g} s")
    elif status.phase is FlightPhase.FORMATION and flown.reference_s > time_s + TIMES_AGREE_S:
        yield Doubt(
            vehicle_id, TIME, f"{flown.reference_s:g} s", f"about {time_s:.0f} s, as the others in formation report"
        )


def _expected_slot(status: Status, fleet: FleetConfig, own: Vector3 | None) -> str:
    """What a slot should be; "" where it may be true: no vehicle accepts a formation that is wider than the fence.

    Formation 0 is that of the fleet file.
    """
    slot, (low, high) = status.formation.slot, (fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m)
    x, y, z = slot.position_enu_m
    width_m = hypot(high[0] - low[0], high[1] - low[1])
    if not (hypot(x, y) <= width_m and abs(z) <= high[2] - low[2]):
        return (
            f"at most {width_m:.0f} m from the reference, and {high[2] - low[2]:.0f} m in height, as the fence is wide"
        )
    if own is None or slot.formation != 0 or slot.moves:
        return ""
    off_m = max(abs(a - b) for a, b in zip(slot.position_enu_m, own, strict=True))
    return f"{_metres(own)} as in the fleet file, in formation 0" if off_m > SLOT_ROUNDING_M else ""


def _with_formation(status: Status, **changes: object) -> Status:
    return replace(status, formation=replace(status.formation, **changes))


def _metres(place: Vector3) -> str:
    return ", ".join(f"{component:.6g}" for component in place) + " m"


def doubts_as_data(doubts: Iterable[Doubt]) -> list[dict[str, Any]]:
    """For programs: vehicle, field, code and text."""
    return [
        {"vehicle_id": d.vehicle_id, "field": d.field, "code": d.notice.code, "text": d.notice.text} for d in doubts
    ]
