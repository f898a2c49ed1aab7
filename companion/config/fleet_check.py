"""Checks of a fleet file that need more than one field: ids, leaders, edges, slots, speeds, airspace, starts."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations
from math import atan, degrees, dist, hypot, inf
from pathlib import Path

from msgspec.structs import replace

from companion.config.degrees import degree_hint
from companion.config.file import convert, read_as, refuse
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.config.law import law_problems
from companion.config.named_files import read_named
from companion.config.validation import INVALID, Problem, each, unless_invalid
from companion.config.values import PositionM, Section, VehicleId, is_multicast
from companion.geometry.airspace import area_m2, crossing_sides
from companion.geometry.formations import ROUNDING_M, SLOT_ACCELERATION_M_S2, to_separation_metric
from companion.types.flight import Role
from companion.types.values import GRAVITY_M_S2, Vector3

SMALLEST_AREA_M2 = 1.0
TILTS_WITHIN_S = 0.5  # the separation filter counts on a vehicle that reaches its largest tilt in this time
CLOSEST_STARTS_M = 0.3  # nearer to each other, two vehicles on the ground touch


def load_fleet(path: Path) -> FleetConfig:
    """Read a fleet file. Raises ConfigError."""
    return convert(path, read_named(read_as(path, "fleet"), path), FleetConfig, fleet_problems)


def fleet_problems(fleet: FleetConfig, where: str = "") -> Iterator[Problem]:
    """All that is wrong between the fields of a fleet. `where` is the path of its section, like "fleet."."""
    with_ids = checkable(fleet)
    of_fields = (
        _members(fleet, f"{where}vehicles"),
        _leader(fleet, f"{where}vehicles"),
        _slots(fleet, f"{where}vehicles"),
        _takeoff_height(fleet, f"{where}takeoff_height_m"),
        airspace_problems(fleet, where),
        _speeds(fleet, f"{where}peers.max_speed_m_s"),
        _tilt_rate(fleet, f"{where}envelope.max_tilt_rate_deg_s"),
        _turning(fleet, f"{where}envelope"),
        _multicast(fleet, f"{where}multicast"),
        _external_vision(fleet, f"{where}external_vision"),
        _battery(fleet, f"{where}land_below_percent"),
        law_problems(fleet.law, f"{where}law"),
    )
    of_ids = (
        _successors(with_ids, f"{where}successors"),
        _edges(with_ids, f"{where}neighbours.edges"),
        _cut_vertices(with_ids, f"{where}neighbours.edges"),
    )
    yield from each(*of_fields, *of_ids)


def _external_vision(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if fleet.external_vision is not None and fleet.origin != "indoor":
        yield Problem(where, "given, and origin is a place on Earth; expected `origin: indoor`, and that place here")


def checkable(fleet: FleetConfig) -> FleetConfig:
    """The fleet for checks by id: without usable ids its vehicles are invalid, so that one error is not reported many times."""
    ids = unless_invalid(lambda: [member.id for member in fleet.vehicles])
    unusable = unless_invalid(lambda: len(set(ids)) < max(len(ids), 1))
    return replace(fleet, vehicles=INVALID) if unusable is True else fleet


def start_problems(fleet: FleetConfig, starts_enu_m: Mapping[int, Vector3]) -> Iterator[Problem]:
    """Every vehicle needs a position to start from, not too near to another."""
    ids = {member.id for member in fleet.vehicles}
    for vehicle_id in sorted(ids - starts_enu_m.keys()):
        yield Problem(f"starts_enu_m.{vehicle_id}", "missing; every vehicle needs a position to start from")
    for vehicle_id in sorted(starts_enu_m.keys() - ids):
        yield Problem(f"starts_enu_m.{vehicle_id}", f"no such vehicle in the fleet; expected {_list_ids(sorted(ids))}")
    for i, j in combinations(sorted(ids & starts_enu_m.keys()), 2):
        if (apart_m := dist(starts_enu_m[i], starts_enu_m[j])) < CLOSEST_STARTS_M:
            yield Problem(
                f"starts_enu_m.{j}",
                f"{list(starts_enu_m[j])} is {apart_m:.2f} m from the start of vehicle {i};"
                f" expected at least {CLOSEST_STARTS_M:g} m{degree_hint(fleet.origin, starts_enu_m[j])}",
            )


def _members(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if not len(fleet.vehicles):
        yield Problem(where, "is empty; list at least one vehicle with id, role and slot_enu_m")
    ids: list[int] = []
    for index, member in enumerate(fleet.vehicles):
        if member.id in ids:
            first = f"{where}[{ids.index(member.id)}]"
            yield Problem(
                f"{where}[{index}].id",
                f"{member.id} is used twice; every vehicle needs an id of its own ({first} has it)",
            )
        ids.append(member.id)


def _leader(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    roles = [member.role == Role.LEADER for member in fleet.vehicles]
    if roles and not any(roles):
        ids = _list_ids([member.id for member in fleet.vehicles])
        yield Problem(where, f"no vehicle leads; set role: leader for at least one of {ids}")


def _successors(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    named: list[int] = []
    for index, vehicle_id in enumerate(fleet.successors):
        member = fleet.member(vehicle_id)
        if member is None or not member.can_lead:
            may_lead = _list_ids([member.id for member in fleet.vehicles if member.can_lead])
            hint = "" if member is None else f", or may_lead: true for vehicle {vehicle_id}"
            yield Problem(f"{where}[{index}]", f"vehicle {vehicle_id} may not lead; expected some of {may_lead}{hint}")
        if vehicle_id in named:
            yield Problem(f"{where}[{index}]", f"{vehicle_id} is named twice; expected each once, in order")
        named.append(vehicle_id)


def _edges(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if not isinstance(fleet.neighbours, EdgeNeighbours):
        return
    ids = [member.id for member in fleet.vehicles]
    for index, edge in enumerate(fleet.neighbours.edges):
        for vehicle_id in edge:
            if vehicle_id not in ids:
                yield Problem(
                    f"{where}[{index}]",
                    f"{list(edge)} names vehicle {vehicle_id}, which is not in the fleet; expected two of {_list_ids(ids)}",
                )
        if edge[0] == edge[1]:
            yield Problem(f"{where}[{index}]", f"{list(edge)} joins a vehicle to itself; expected two different ids")


def _cut_vertices(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """With `close_up` the graph must stay connected without any one vehicle: edges join vehicles, not slots."""
    if fleet.when_one_leaves != "close_up" or not isinstance(fleet.neighbours, EdgeNeighbours):
        return
    ids = [member.id for member in fleet.vehicles]
    for gone_id in ids:
        edges = [edge for edge in fleet.neighbours.edges if gone_id not in edge]
        rest = [vehicle_id for vehicle_id in ids if vehicle_id != gone_id]
        reached, fresh = set(rest[:1]), set(rest[:1])
        while fresh:
            fresh = {b for edge in edges for a, b in (edge, edge[::-1]) if a in fresh} - reached
            reached |= fresh
        if cut_off := [vehicle_id for vehicle_id in rest if vehicle_id not in reached]:
            yield Problem(
                where,
                f"without vehicle {gone_id}, vehicle {cut_off[0]} is cut off from vehicle {rest[0]}; expected edges that stay"
                " connected without any one vehicle, or when_one_leaves: keep_gap",
            )


def _slots(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """One problem for each vehicle whose slot is nearer than `separation_m` to that of a vehicle listed before it."""
    separation_m, has_height = fleet.separation_m, fleet.law.altitude == "formation"
    before: list[tuple[int, Vector3]] = []
    for index, member in enumerate(fleet.vehicles):
        slot = to_separation_metric(member.slot_enu_m, has_height)
        apart_m, other_id = min(((dist(slot, other), i) for i, other in before), default=(inf, 0))
        if apart_m < separation_m - ROUNDING_M:
            yield Problem(
                f"{where}[{index}].slot_enu_m",
                f"{list(member.slot_enu_m)} of vehicle {member.id} is {apart_m:.2f} m from the slot of vehicle {other_id};"
                f" expected at least separation_m, {separation_m:g} m{degree_hint(fleet.origin, member.slot_enu_m)}",
            )
        before.append((member.id, slot))


def _takeoff_height(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    top_m = fleet.envelope.fence_max_enu_m[2]
    if fleet.takeoff_height_m > top_m:
        yield Problem(where, f"{fleet.takeoff_height_m:g} is above the fence, which ends at {top_m:g} m")


def _speeds(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """Peers must accept the states of a vehicle at the fastest it flies."""
    envelope, accepted_m_s = fleet.envelope, fleet.peers.max_speed_m_s
    fastest_m_s = hypot(envelope.max_speed_m_s, max(envelope.max_climb_m_s, envelope.max_descent_m_s))
    if accepted_m_s < fastest_m_s:
        yield Problem(
            where,
            f"{accepted_m_s:g} is less than the {fastest_m_s:.1f} m/s that envelope.max_speed_m_s, max_climb_m_s and"
            " max_descent_m_s allow; lower those, or raise it",
        )


def _tilt_rate(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """A vehicle that tilts slowly evades too late."""
    rate_deg_s, least_deg_s = fleet.envelope.max_tilt_rate_deg_s, fleet.envelope.max_tilt_deg / TILTS_WITHIN_S
    if rate_deg_s < least_deg_s:
        yield Problem(
            where,
            f"{rate_deg_s:g} is too slow to evade with max_tilt_deg {fleet.envelope.max_tilt_deg:g}; expected at least"
            f" {least_deg_s:g}, or less tilt",
        )


def _turning(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """Slots that turn with the course leave a reference less speed and tilt; without any left none can move."""
    if not fleet.slots_turn:
        return
    envelope, least_deg = fleet.envelope, degrees(atan(SLOT_ACCELERATION_M_S2 / GRAVITY_M_S2))
    reserved = "what slots need that turn with the course (formation_heading)"
    if envelope.max_tilt_deg <= least_deg:
        text = f"{envelope.max_tilt_deg:g} is no more than {reserved}; expected more than {least_deg:.1f}"
        yield Problem(f"{where}.max_tilt_deg", text)
    if envelope.max_speed_m_s <= fleet.slot_speed_m_s:
        text = f"{envelope.max_speed_m_s:g} is no more than {reserved}; expected more than slot_speed_m_s"
        yield Problem(f"{where}.max_speed_m_s", f"{text}, {fleet.slot_speed_m_s:g}")


def _multicast(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    if fleet.multicast is not None and not is_multicast(fleet.multicast):
        host = fleet.multicast.rpartition(":")[0]
        yield Problem(where, f'"{host}" is no multicast group; expected one from 224.0.0.0 to 239.255.255.255')


def _battery(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    """A vehicle leaves with more charge than it lands with."""
    leave, land = fleet.leave_below_percent, fleet.land_below_percent
    if leave is not None and land is not None and land > leave:
        yield Problem(
            where,
            f"{land:g} is more than leave_below_percent, {leave:g}: the vehicle would land before it leaves the formation;"
            f" expected at most {leave:g}",
        )


def airspace_problems(fleet: FleetConfig, where: str = "") -> Iterator[Problem]:
    """Fence and obstacles that cannot be used. `where` is the path of the fleet's section."""
    envelope = fleet.envelope
    lows, highs = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    for axis, low, high in zip("xyz", lows, highs, strict=True):
        if low >= high:
            yield Problem(
                f"{where}envelope.fence_min_enu_m", f"{axis} is {low}, expected less than fence_max_enu_m's {high}"
            )
        elif high - low <= 2.0 * envelope.clearance_m:
            text = f"{envelope.clearance_m:g} leaves no room along {axis}, where the fence is {high - low:g} m wide"
            yield Problem(f"{where}envelope.clearance_m", text)
    yield from _polygon(fleet, f"{where}envelope.fence_corners_enu_m")
    for index, obstacle in enumerate(fleet.obstacles):
        for key, problem in obstacle.contradictions():
            yield Problem(f"{where}obstacles[{index}].{key}", problem)


def _polygon(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    corners = fleet.envelope.fence_corners_enu_m
    if not len(corners):
        return
    if len(corners) < 3:
        yield Problem(where, f"has {len(corners)} corners; expected at least 3, or none for a box")
    elif crossing := crossing_sides(corners):
        i, j = crossing
        yield Problem(where, f"the sides that begin at corners {i} and {j} touch or cross; expected corners in order")
    elif (size_m2 := area_m2(corners)) < SMALLEST_AREA_M2:
        yield Problem(where, f"has an area of {size_m2:.2f} m^2; expected at least {SMALLEST_AREA_M2:g}")


def _list_ids(ids: list[int]) -> str:
    return ", ".join(str(i) for i in ids)


class SlotsSection(Section, frozen=True):
    """The slot of every vehicle of the fleet.

    slots_enu_m: d_i0 of eq. 12 by vehicle id
    """

    slots_enu_m: dict[VehicleId, PositionM]


def load_slots(path: Path, fleet: FleetConfig) -> dict[int, Vector3]:
    """Slot by vehicle id, one for each vehicle of the fleet. Raises ConfigError."""
    section = convert(path, read_as(path, "slots"), SlotsSection, lambda section: _problems(section.slots_enu_m, fleet))
    return dict(section.slots_enu_m)


def check_slots(source: Path, slots_enu_m: Mapping[int, Vector3], fleet: FleetConfig) -> None:
    """`source` is named in errors. Raises ConfigError."""
    refuse(source, _problems(slots_enu_m, fleet))


def _problems(slots_enu_m: Mapping[int, Vector3], fleet: FleetConfig) -> Iterator[Problem]:
    ids = {member.id for member in fleet.vehicles}
    known = ", ".join(str(i) for i in sorted(ids))
    for vehicle_id in sorted(ids ^ slots_enu_m.keys()):
        problem = "missing" if vehicle_id in ids else "no such vehicle in the fleet"
        yield Problem(f"slots_enu_m.{vehicle_id}", f"{problem}; expected a slot for each of {known}")
