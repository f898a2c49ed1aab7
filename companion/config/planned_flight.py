"""The part of a scenario that `companion analyze` reads: fleet and starts, with the defaults of a simulated flight.

The default neighbours and the neighbour graphs of new fleets are here, too.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import combinations, pairwise
from math import dist, radians
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from msgspec import Meta

from companion.config.fleet import (
    EdgeNeighbours,
    FleetConfig,
    FleetSettings,
    FormationMember,
    GeodeticOrigin,
    RangeNeighbours,
)
from companion.config.fleet_check import checkable, fleet_problems, start_problems
from companion.config.validation import INVALID, Problem, each, unless_invalid
from companion.config.values import Name, PositionM, Section, VehicleId, about
from companion.geometry.formations import SHAPES, slots_of
from companion.types.flight import Role
from companion.types.values import Vector3

DEFAULT_ORIGIN = GeodeticOrigin(latitude_deg=47.397742, longitude_deg=8.545594, altitude_amsl_m=488.0)
"""Zurich, the usual home of PX4's simulations."""
RANGE_FACTOR, HYSTERESIS_FACTOR = 1.5, 0.25
"""The default range and hysteresis, in units of the shortest range that connects all slots."""
START_CLEARANCE = 1.2
"""Smallest distance of default starts in the plane, in units of `separation_m`."""

if TYPE_CHECKING:
    ShapeName: TypeAlias = str
else:
    ShapeName = Literal[tuple(SHAPES)]
HeadingDeg = Annotated[float, about("heading of the formation: 0 is east, 90 is north", ge=-360, le=360)]
SpacingM = Annotated[float, about("smallest distance between slots", gt=0, le=1000)]
VehicleCount = Annotated[int, Meta(ge=1, le=250)]


class NamedFormation(Section, frozen=True, kw_only=True):
    """Slots by the name of a shape.

    shape: name of the shape
    """

    shape: ShapeName
    spacing_m: SpacingM
    heading_deg: HeadingDeg = 0.0


class ScenarioFleet(FleetSettings, frozen=True, kw_only=True):
    """The fleet of a scenario: a fleet file's settings, where name, origin, slots and neighbours have defaults.

    name: name of the fleet on the network
    origin: zero of the fleet frame; the default is 47.397742 N, 8.545594 E, 488 m
    vehicles: the vehicles with their roles and slots, or only their number, with `formation`
    formation: the slots, if `vehicles` is a number; the ids begin at 1, and vehicle 1 is the leader
    neighbours: the neighbours of each vehicle; the default is by range: 1.5 times the shortest range that connects all
        slots, with 0.25 times that range as hysteresis
    """

    name: Name = "simulation"
    origin: GeodeticOrigin | Literal["indoor"] = DEFAULT_ORIGIN
    vehicles: tuple[FormationMember, ...] | VehicleCount
    formation: NamedFormation | None = None
    neighbours: EdgeNeighbours | RangeNeighbours | None = None


class PlannedFlight(Section, frozen=True, kw_only=True):
    """The fleet of a scenario before the flight.

    description: one sentence about the flight
    starts_enu_m: start of each vehicle by id; the default is the ground below its slot at the reference's start
    """

    description: str = ""
    fleet: ScenarioFleet
    starts_enu_m: dict[VehicleId, PositionM] | None = None


def fleet_of(planned: ScenarioFleet) -> FleetConfig:
    """The fleet with its defaults."""
    settings: dict[str, Any] = {name: getattr(planned, name) for name in FleetSettings.__struct_fields__}
    vehicles = unless_invalid(lambda: _vehicles(planned))
    neighbours = planned.neighbours
    if neighbours is None:
        neighbours = unless_invalid(lambda: default_neighbours([member.slot_enu_m for member in vehicles]))
    return FleetConfig(name=planned.name, origin=planned.origin, vehicles=vehicles, neighbours=neighbours, **settings)


def starts_of(planned: PlannedFlight, fleet: FleetConfig, reference_enu_m: Vector3) -> Mapping[int, Vector3]:
    """The starts with their default: below the slots about this position of the reference, on the ground."""
    if planned.starts_enu_m is not None:
        return planned.starts_enu_m
    return unless_invalid(lambda: _default_starts(fleet, reference_enu_m))


def planned_problems(
    planned: PlannedFlight, fleet: FleetConfig, starts_enu_m: Mapping[int, Vector3]
) -> Iterator[Problem]:
    """All that is wrong between the fields of fleet and starts."""
    yield from each(
        _formation(planned.fleet), fleet_problems(fleet, "fleet."), start_problems(checkable(fleet), starts_enu_m)
    )


def default_neighbours(slots_enu_m: list[Vector3]) -> RangeNeighbours:
    """Neighbours by range, from the shortest range that connects all slots."""
    connecting_m = _connecting_range_m(slots_enu_m)
    return RangeNeighbours(
        range_m=round(max(RANGE_FACTOR * connecting_m, 1.0), 3), hysteresis_m=round(HYSTERESIS_FACTOR * connecting_m, 3)
    )


def members_of(shape: ShapeName, count: int, spacing_m: float, heading_deg: float = 0.0) -> tuple[FormationMember, ...]:
    """Vehicles 1 to `count` in the slots of a shape, to the millimetre. Vehicle 1 is the leader."""
    slots = slots_of(SHAPES[shape], count, spacing_m, radians(heading_deg))
    return tuple(
        FormationMember(id=index + 1, role=Role.FOLLOWER if index else Role.LEADER, slot_enu_m=_round(slot))
        for index, slot in enumerate(slots)
    )


def _vehicles(planned: ScenarioFleet) -> tuple[FormationMember, ...]:
    if not isinstance(planned.vehicles, int):
        return planned.vehicles
    shape = INVALID if planned.formation is None else planned.formation
    return members_of(shape.shape, planned.vehicles, shape.spacing_m, shape.heading_deg)


def _formation(planned: ScenarioFleet) -> Iterator[Problem]:
    if isinstance(planned.vehicles, int) and planned.formation is None:
        yield Problem("fleet.formation", f"missing; vehicles: {planned.vehicles} needs a shape and its spacing_m")
    if isinstance(planned.vehicles, tuple) and planned.formation is not None:
        yield Problem("fleet.formation", "goes with a number of vehicles; take it out, or give vehicles as a number")


def _default_starts(fleet: FleetConfig, reference_enu_m: Vector3) -> dict[int, Vector3]:
    """Slots above each other are moved apart, so that the vehicles can take off together."""
    x0, y0, _ = reference_enu_m
    slots = {member.id: member.slot_enu_m for member in fleet.vehicles}
    nearest_m = min((dist(a[:2], b[:2]) for a, b in combinations(slots.values(), 2)), default=fleet.separation_m)
    needed_m = START_CLEARANCE * fleet.separation_m
    scale = max(1.0, needed_m / nearest_m) if nearest_m > 0.0 and nearest_m < fleet.separation_m else 1.0
    return {i: _round((x0 + scale * x, y0 + scale * y, 0.0)) for i, (x, y, _) in slots.items()}


def _connecting_range_m(slots_enu_m: list[Vector3]) -> float:
    """The longest edge of the minimum spanning tree of the slots (Prim)."""
    distances_m = {index: dist(slots_enu_m[0], slot) for index, slot in enumerate(slots_enu_m)}
    longest_m = 0.0
    while distances_m:
        index = min(distances_m, key=lambda i: distances_m[i])
        longest_m = max(longest_m, distances_m.pop(index))
        distances_m = {i: min(d, dist(slots_enu_m[index], slots_enu_m[i])) for i, d in distances_m.items()}
    return longest_m


def _round(position_m: Vector3) -> Vector3:
    x, y, z = (round(coordinate, 3) + 0.0 for coordinate in position_m)
    return (x, y, z)


Topology = Literal["chain", "double", "ring", "all", "range"]
TOPOLOGY_WORDS: dict[Topology, str] = {
    "chain": "each vehicle and the nearest one with a lower id",
    "double": "each vehicle and the two nearest with lower ids; connected without any one vehicle",
    "ring": "each vehicle and the next id; the last one and the first",
    "all": "all pairs",
    "range": "all vehicles within a range, as they fly",
}


def neighbour_graph(
    neighbours: EdgeNeighbours | RangeNeighbours, positions_enu_m: Mapping[int, Vector3]
) -> dict[int, list[int]]:
    """Neighbour ids of every vehicle, from the edges or from the distances of these positions."""
    graph: dict[int, list[int]] = {i: [] for i in positions_enu_m}
    for i, j in combinations(sorted(graph), 2):
        if isinstance(neighbours, EdgeNeighbours):
            near = (i, j) in neighbours.edges or (j, i) in neighbours.edges
        else:
            near = dist(positions_enu_m[i], positions_enu_m[j]) <= neighbours.range_m
        if near:
            graph[i].append(j)
            graph[j].append(i)
    return graph


def graph_in_slots(fleet: FleetConfig) -> dict[int, list[int]]:
    """The neighbours of the vehicles in their slots: with a range they are others than at the start."""
    return neighbour_graph(fleet.neighbours, {member.id: member.slot_enu_m for member in fleet.vehicles})


def neighbours_of(topology: Topology, members: tuple[FormationMember, ...]) -> EdgeNeighbours | RangeNeighbours:
    """The neighbours of these vehicles in this graph."""
    if topology == "range":
        return default_neighbours([member.slot_enu_m for member in members])
    return EdgeNeighbours(edges=tuple(_edges(topology, {member.id: member.slot_enu_m for member in members})))


def _edges(topology: Topology, slots: dict[int, tuple[float, float, float]]) -> list[tuple[int, int]]:
    ids = sorted(slots)
    if topology == "all":
        return list(combinations(ids, 2))
    if topology == "ring":
        closing = [(ids[-1], ids[0])] if len(ids) > 2 else []
        return [*pairwise(ids), *closing]
    count = 1 if topology == "chain" else 2
    return [
        (other, vehicle_id)
        for index, vehicle_id in enumerate(ids)
        for other in sorted(sorted(ids[:index], key=lambda i: dist(slots[i], slots[vehicle_id]))[:count])
    ]
