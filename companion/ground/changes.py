"""What an operator asks of a fleet, and the changes it leads to: a formation with its slots, a reference (RFT).

A change has a number, and begins in all vehicles at once: AHEAD_S after the fleet time that they report. Pure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist, hypot, radians
from pathlib import Path
from types import MappingProxyType

from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_slots
from companion.config.reference import PLACED, Reference, commanded, load_reference
from companion.geometry.curves import duration_s
from companion.geometry.formations import (
    ROUNDING_M,
    SHAPES,
    SLOT_ACCELERATION_M_S2,
    closest_approach,
    longest_path_m,
    rotated,
    slots_of,
    to_separation_metric,
)
from companion.types.commands import Described, ReferenceChange, next_for_all
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationChange
from companion.types.status import Status
from companion.types.values import MIN_CHANGE_S, Vector3

NO_REACH: Mapping[int, float] = MappingProxyType({})
BEHIND = 1.5  # in separation_m: how far behind the formation the slot of a vehicle is whose own is not known


def command_line(action: str) -> Path:
    """Named in an error in place of a file."""
    return Path(f"companion fleet {action}")


@dataclass(frozen=True, slots=True)
class FormationRequest:
    """A shape by its name with `spacing_m`, or slots, or neither: the present slots. Each is rotated and scaled.

    Slots are those in `slots_file`, or `slots_enu_m` by vehicle id.
    """

    shape: str | None
    slots_file: Path | None
    spacing_m: float | None
    heading_deg: float
    scale: float
    slots_enu_m: Mapping[int, Vector3] | None = None


@dataclass(frozen=True, slots=True)
class ReferenceRequest:
    """A file, or the keys of its section `reference` without positions; `positions_enu_m` has every --at.

    Or `whole`, a reference that is complete.
    """

    file: Path | None
    described: Described
    positions_enu_m: tuple[list[float], ...]
    whole: Reference | None = None


@dataclass(frozen=True, slots=True)
class FleetAction:
    """One action for a fleet, by its name in `companion fleet`. `only` is empty for all vehicles of the fleet.

    `leaders`, `formation` and `reference` belong to one action each.
    """

    name: str
    only: tuple[int, ...] = ()
    leaders: tuple[int, ...] = ()
    formation: FormationRequest | None = None
    reference: ReferenceRequest | None = None


def reference_change(reference: Described, statuses: Sequence[Status]) -> ReferenceChange:
    """`reference` as in a file, with the next number, AHEAD_S after the fleet time of these reports."""
    held = [status.formation.reference for status in statuses if status.formation.reference]
    number = next_for_all(number for one in held for number in (one.flown, one.waiting))
    return ReferenceChange(number, reference, fleet_time_s(statuses) + AHEAD_S)


def resolve_reference_now(request: ReferenceRequest, statuses: Collection[Status]) -> Reference:
    """The reference of a request to a fleet with these reports. Raises ConfigError."""
    return resolve_reference(request, here_enu_m=flown_reference_enu_m(statuses))


def flown_reference_enu_m(statuses: Collection[Status]) -> Vector3 | None:
    """The reference of the leader that most vehicles follow; None where no vehicle reports one."""
    beacons = [status.leadership.leader_beacon for status in statuses]
    followed = Counter(beacon.leader_id for beacon in beacons if beacon)
    reports = [status for status in statuses if status.formation.reference_enu_m]
    reports.sort(key=lambda status: (-followed[status.agent.vehicle_id], status.leadership.role is not Role.LEADER))
    return reports[0].formation.reference_enu_m if reports else None


def resolve_reference(request: ReferenceRequest, here_enu_m: Vector3 | None) -> Reference:
    """The reference of a request. A target without a position is awaited `here_enu_m`. Raises ConfigError."""
    if request.whole is not None:
        return request.whole
    if request.file is not None:
        if request.described or request.positions_enu_m:
            raise ConfigError(
                command_line("reference"),
                "--file",
                "describes the whole reference; give it alone, or KIND with its options",
            )
        return load_reference(request.file)
    described, where = request.described, command_line("reference")
    name = described.get("kind")
    if not isinstance(name, str):
        raise ConfigError(where, "KIND", f"missing; expected one of {', '.join(PLACED)}, or --file FILE")
    kind = PLACED[name]
    positions = [list(position) for position in request.positions_enu_m]
    if kind.AWAITED and not positions:
        if here_enu_m is None:
            problem = "missing; no leader reports a reference: give the position to await the target at"
            raise ConfigError(where, "--at", problem)
        positions = [list(here_enu_m)]
    most = kind.MOST_POSITIONS
    if not positions or (len(positions) > 1 and most == 1):
        expected = "one or more" if most > 1 else "one"
        raise ConfigError(where, "--at", f"given {len(positions)} times; a reference {name} has {expected}")
    position = {kind.POSITION: positions if most > 1 else positions[0]}
    return commanded(where, {"reference": described | position})


def named_slots(shape: str, n: int, spacing_m: float, heading_deg: float) -> list[Vector3]:
    """The slots of a shape of SHAPES for n vehicles. Raises KeyError for another name."""
    return slots_of(SHAPES[shape], n, spacing_m, radians(heading_deg))


def check_request(request: FormationRequest, fleet: FleetConfig) -> None:
    """The checks that need no report of a vehicle. Raises ConfigError."""
    if request.shape and request.slots_file:
        raise ConfigError(
            command_line("formation"), "--slots", f"is a whole formation; give it or {request.shape}, not both"
        )
    if request.shape and request.spacing_m is None:
        raise ConfigError(
            command_line("formation"), "--spacing", f"missing; {request.shape} needs it: --spacing METRES"
        )
    if request.spacing_m is not None and not request.shape:
        raise ConfigError(command_line("formation"), "--spacing", "belongs to a SHAPE, and none is given")
    if request.slots_file:
        load_slots(request.slots_file, fleet)
    elif not request.shape and request.slots_enu_m is None and request.scale == 1.0 and request.heading_deg == 0.0:
        raise ConfigError(
            command_line("formation"),
            "SHAPE",
            "missing; expected one, --slots FILE, or --scale or --heading for the present slots",
        )


def resolve_slots(
    request: FormationRequest, statuses: Sequence[Status], fleet: FleetConfig, unsure: Collection[int] = ()
) -> dict[int, Vector3]:
    """The slot of each vehicle of the fleet: as in the file, the flown one, or assigned for a shape. Raises ConfigError.

    A shape has a slot for a vehicle without a status or a position, too: one that is left over. Of a vehicle without a status
    the slot in the fleet file counts as flown; it and the `unsure` vehicles go behind the others where they would be too near.
    """
    ids = sorted({member.id for member in fleet.vehicles} | {status.agent.vehicle_id for status in statuses})
    if request.shape and request.spacing_m is not None:
        slots = named_slots(request.shape, len(ids), request.spacing_m * request.scale, request.heading_deg)
        assigned = assign_slots(positions_enu_m(statuses), slots)
        free = [slot for slot in slots if slot not in assigned.values()]
        return assigned | dict(zip((i for i in ids if i not in assigned), free, strict=True))
    reported_enu_m, given = flown_slots_enu_m(statuses), request.slots_enu_m
    flown_enu_m = {member.id: member.slot_enu_m for member in fleet.vehicles} | reported_enu_m
    slots_enu_m = load_slots(request.slots_file, fleet) if request.slots_file else given or flown_enu_m
    turned = {i: rotated(slot, radians(request.heading_deg), request.scale) for i, slot in slots_enu_m.items()}
    if request.slots_file or given:
        return turned
    result = {i: slot for i, slot in turned.items() if i in reported_enu_m and i not in unsure}
    for i in sorted(turned.keys() - result.keys()):
        result[i] = free_slot(turned[i], list(result.values()), fleet)
    return result


def is_free(slot: Vector3, taken: Collection[Vector3], fleet: FleetConfig) -> bool:
    """Whether a slot keeps `separation_m` from these."""
    has_height = fleet.law.altitude == "formation"
    place = to_separation_metric(slot, has_height)
    return all(
        dist(place, to_separation_metric(other, has_height)) >= fleet.separation_m - ROUNDING_M for other in taken
    )


def free_slot(own: Vector3 | None, taken: Collection[Vector3], fleet: FleetConfig) -> Vector3:
    """That of the fleet file, or a place behind the others where it is not free."""
    if own and is_free(own, taken, fleet):
        return own
    x, y, z = min(taken, default=(0.0, 0.0, 0.0))
    return x - BEHIND * fleet.separation_m, y, z


def flown_slots_enu_m(statuses: Iterable[Status]) -> dict[int, Vector3]:
    """By vehicle, in the formation's frame."""
    return {status.agent.vehicle_id: status.formation.slot.position_enu_m for status in statuses}


def positions_enu_m(statuses: Sequence[Status]) -> dict[int, Vector3]:
    """Positions of the vehicles in the formation's frame: their slots in flight, before it their own where they are known.

    Own positions are not relative to the RFT; that changes neither the assignment of slots nor the distances of vehicles.
    """
    if any(status.phase is FlightPhase.FORMATION for status in statuses):
        return flown_slots_enu_m(statuses)
    return {
        s.agent.vehicle_id: rotated(s.motion.position_enu_m, -s.formation.heading.angle_rad, 1.0)
        for s in statuses
        if s.motion.is_known
    }


def assign_slots(flown_enu_m: Mapping[int, Vector3], slots_enu_m: Sequence[Vector3]) -> dict[int, Vector3]:
    """A slot for each vehicle with the least sum of squared distances: no two straight paths cross (see transition.py)."""
    from scipy.optimize import linear_sum_assignment  # takes seconds to load

    if not flown_enu_m:
        return {}
    ids = sorted(flown_enu_m)
    cost_m2 = [
        [sum((a - b) ** 2 for a, b in zip(flown_enu_m[i], slot, strict=True)) for slot in slots_enu_m] for i in ids
    ]
    _, chosen = linear_sum_assignment(cost_m2)
    return {vehicle_id: slots_enu_m[index] for vehicle_id, index in zip(ids, chosen.tolist(), strict=True)}


def refusal_of(slots_enu_m: Mapping[int, Vector3], separation_m: float, has_height: bool) -> str | None:
    """The reason why no vehicle is sent these slots: two are too close; None where they may be flown.

    Without `has_height` each vehicle keeps its own altitude. Paths may cross: the vehicles warn of it in their answers.
    """
    slots = {i: to_separation_metric(slot, has_height) for i, slot in slots_enu_m.items()}
    distance_m, i, j = closest_approach(slots, slots)
    if distance_m >= separation_m - ROUNDING_M:
        return None
    return (
        f"the slots of vehicles {i} and {j} come within {distance_m:.2f} m of each other;"
        f" expected at least separation_m, {separation_m:g} m"
    )


def change_to(
    slots_enu_m: Mapping[int, Vector3],
    statuses: Sequence[Status],
    slot_speed_m_s: float,
    reach_m: Mapping[int, float] = NO_REACH,
) -> FormationChange:
    """The change for all vehicles, with the next number, AHEAD_S after their fleet time. Those without a status are absent.

    `reach_m`: of vehicles whose slot others know better than these reports, how far from the reference it may be. The change
    lasts long enough for their paths; the others would refuse a shorter one as too fast.
    """
    path_m = longest_path_m(flown_slots_enu_m(statuses), slots_enu_m)
    path_m = max([path_m, *(hypot(*slots_enu_m[i]) + most_m for i, most_m in reach_m.items() if i in slots_enu_m)])
    lasts_s = duration_s(path_m, slot_speed_m_s, SLOT_ACCELERATION_M_S2)
    slots = [status.formation.slot for status in statuses]
    return FormationChange(
        number=next_for_all(number for slot in slots for number in (slot.formation, slot.waiting)),
        slots_enu_m=tuple(sorted(slots_enu_m.items())),
        begins_s=fleet_time_s(statuses) + AHEAD_S,
        lasts_s=max(lasts_s, MIN_CHANGE_S),
        absent=tuple(sorted(slots_enu_m.keys() - {status.agent.vehicle_id for status in statuses})),
    )


AHEAD_S = 1.0  # seconds from a command to its beginning: every vehicle has received it by then


TIMES_AGREE_S = 5.0  # vehicles in formation differ by the way of the leader's beacon
STOPPED_APART_S = 50.0  # a vehicle accepts a change that begins up to a minute after its own time


def fleet_time_s(statuses: Collection[Status]) -> float:
    """Time along the RFT by these reports, seconds; it does not advance while no leader is in formation.

    The largest one of those in formation, else of all. Where two agree, one that stands alone above them is not believed: no
    vehicle would accept a change that begins then. Where no two agree, it is that of a leader. While none is in formation each
    has the time at which it left, and they agree over STOPPED_APART_S.
    """
    formed = [status for status in statuses if status.phase is FlightPhase.FORMATION]
    known = [status for status in formed or statuses if status.formation.reference_s > 0.0]
    times_s = sorted((status.formation.reference_s for status in known), reverse=True)
    led_s = [status.formation.reference_s for status in known if status.leadership.role is Role.LEADER]
    apart_s = TIMES_AGREE_S if formed else STOPPED_APART_S
    agreed_s = (later for later, earlier in pairwise(times_s) if later - earlier <= apart_s)
    return next(agreed_s, max(led_s or times_s, default=0.0))
