"""A fleet file: what all vehicles of a fleet must agree on. Its hash travels with every peer packet."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from itertools import combinations
from math import dist
from pathlib import Path
from typing import Annotated, Literal

import msgspec
from msgspec import Meta

from companion.config.kind import read_as
from companion.config.law import Law, check_law
from companion.config.values import PositionM, Section, VehicleId
from companion.config_file import ConfigError, convert
from companion.types import Role, Vector3

FLEET_NAME = "^[a-z0-9][a-z0-9_-]{0,40}$"  # it is a part of Zenoh's key expressions
FLEET_NAME_WORDS = "at most 41 lower-case letters, digits, - and _, a letter or digit first"
CLOSEST_STARTS_M = 0.3  # nearer, two vehicles stand in one another


class GeodeticOrigin(Section, frozen=True):
    """Where the fleet frame (ENU) has its zero."""

    latitude_deg: Annotated[float, Meta(ge=-85, le=85)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]
    altitude_amsl_m: Annotated[float, Meta(ge=-500, le=9000)]

    def as_tuple(self) -> Vector3:
        return (self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)


class FormationMember(Section, frozen=True):
    """One vehicle's place. `slot_enu_m` is d_i0 of eq. 12, the offset from the RFT.

    `role` is that at the beginning. Who leads then may be told to follow; of the others, those with `may_lead` to lead.
    """

    id: VehicleId
    role: Role
    slot_enu_m: PositionM
    may_lead: bool = False

    @property
    def can_lead(self) -> bool:
        """Does it hold the RFT?"""
        return self.may_lead or self.role is Role.LEADER


class RangeNeighbours(Section, frozen=True, tag_field="kind", tag="range"):
    """A vehicle becomes a neighbour within `range_m` and stays one until it is `hysteresis_m` farther away."""

    range_m: Annotated[float, Meta(gt=0, le=10_000)]
    hysteresis_m: Annotated[float, Meta(ge=0, le=1_000)] = 0.0


class EdgeNeighbours(Section, frozen=True, tag_field="kind", tag="edges"):
    """Neighbours are given as undirected edges between vehicle ids."""

    edges: tuple[tuple[VehicleId, VehicleId], ...]


class PeerLimits(Section, frozen=True):
    """What is believed of a peer, and for how long."""

    max_age_s: Annotated[float, Meta(gt=0.02, le=5)] = 0.3
    leader_word_max_age_s: Annotated[float, Meta(gt=0.02, le=10)] = 0.25  # two hops on it is missed within 0.3 s
    max_speed_m_s: Annotated[float, Meta(gt=0, le=100)] = 25.0


class Envelope(Section, frozen=True):
    """The last gate's limits. The fence is a box in the fleet frame."""

    max_tilt_deg: Annotated[float, Meta(gt=0, le=45)] = 25.0
    max_tilt_rate_deg_s: Annotated[float, Meta(gt=0, le=1000)] = 120.0  # 2.4 degrees from one setpoint to the next
    min_thrust_ratio: Annotated[float, Meta(gt=0, lt=1)] = 0.3  # of hover thrust
    max_thrust_ratio: Annotated[float, Meta(gt=1, le=4)] = 1.6
    max_thrust_rate_1_s: Annotated[float, Meta(gt=0, le=100)] = 10.0  # hover thrusts per second
    fence_min_enu_m: PositionM = (-100.0, -100.0, -5.0)
    fence_max_enu_m: PositionM = (100.0, 100.0, 50.0)


class FleetConfig(Section, frozen=True):
    """What all vehicles of a fleet must agree on.

    `origin` is `indoor` where one motion-capture system gives all vehicles one frame. `altitude_source` says where z is
    zero: at the origin's altitude (indoors the shared frame's zero), or, with `takeoff`, where each vehicle stood when it
    was armed, for fleets that start from level ground. Only vehicles that stand within `ground_spread_m` of each other in
    altitude, and in the plane no nearer than `separation_m`, take off. No formation that is commanded in flight brings
    slots nearer than that, also on the way to it, and on that way they move at `slot_speed_m_s` at most. A hand-over from
    one reference to another in flight adds no more than `hand_over_speed_m_s` and `hand_over_acceleration_m_s2` to what
    both ask for. With `formation_heading: course` the slots' x axis points where the RFT goes, and they turn about it at
    `slot_speed_m_s` at most; `fixed`, x is always east. When no leader is heard any more, the first of the `successors`
    that flies in formation leads; where none does, all go into their autopilots' hold, and after `land_after_s` in it each
    lands where it is, or stays up where that is not given. A vehicle whose battery stays below `leave_below_percent` leaves
    formation by itself and lands; where that is not given, none does. When one has left, its gap is kept for it, or the
    others `close_up` as soon as its place is free, and it may come back outside: for that, edges must hold together without
    any one vehicle.
    """

    name: Annotated[str, Meta(pattern=FLEET_NAME, description=FLEET_NAME_WORDS)]
    origin: GeodeticOrigin | Literal["indoor"]
    vehicles: tuple[FormationMember, ...]
    neighbours: EdgeNeighbours | RangeNeighbours
    altitude_source: Literal["origin", "takeoff"] = "origin"
    ground_spread_m: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    law: Law = Law()
    separation_m: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    slot_speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 1.0
    hand_over_speed_m_s: Annotated[float, Meta(gt=0, le=50)] = 2.0
    hand_over_acceleration_m_s2: Annotated[float, Meta(gt=0, le=20)] = 1.0
    formation_heading: Literal["fixed", "course"] = "fixed"
    takeoff_height_m: Annotated[float, Meta(ge=0.5, le=120)] = 2.5
    successors: tuple[VehicleId, ...] = ()
    land_after_s: Annotated[float, Meta(gt=0, le=3600)] | None = None
    when_one_leaves: Literal["keep_gap", "close_up"] = "keep_gap"
    leave_below_percent: Annotated[float, Meta(gt=0, le=90)] | None = None
    peers: PeerLimits = PeerLimits()
    envelope: Envelope = Envelope()

    @property
    def slots_turn(self) -> bool:
        """About the RFT, with its course."""
        return self.formation_heading == "course"

    def formation_hash(self) -> int:
        """64 bits over everything in this file: two vehicles fly together only where it is the same."""
        digest = hashlib.sha256(msgspec.json.encode(self, order="sorted")).digest()
        return int.from_bytes(digest[:8], "big")

    def member(self, vehicle_id: int) -> FormationMember | None:
        return next((m for m in self.vehicles if m.id == vehicle_id), None)


def load_fleet(path: Path) -> FleetConfig:
    """Read a fleet file. Raises ConfigError."""
    fleet = convert(path, read_as(path, "fleet"), FleetConfig)
    check_fleet(path, fleet)
    return fleet


def check_fleet(file: Path, fleet: FleetConfig, where: str = "") -> None:
    """Ids unique, a leader, edges between known vehicles, a fence that is a box. Raises ConfigError."""
    ids = [member.id for member in fleet.vehicles]
    known = ", ".join(str(i) for i in ids)
    if not ids:
        raise ConfigError(file, f"{where}vehicles", "is empty; list at least one vehicle with id, role and slot_enu_m")
    for index, vehicle_id in enumerate(ids):
        if vehicle_id in ids[:index]:
            raise ConfigError(
                file,
                f"{where}vehicles[{index}].id",
                f"{vehicle_id} is used twice; every vehicle needs an id of its own (vehicles[{ids.index(vehicle_id)}] has it)",
            )
    if not any(member.role is Role.LEADER for member in fleet.vehicles):
        raise ConfigError(file, f"{where}vehicles", "no vehicle leads; set role: leader for at least one of " + known)
    _check_successors(file, f"{where}successors", fleet)
    check_law(file, f"{where}law", fleet.law)
    if isinstance(fleet.neighbours, EdgeNeighbours):
        _check_edges(file, f"{where}neighbours.edges", fleet.neighbours, ids)
        if fleet.when_one_leaves == "close_up":
            _check_nobody_cuts(file, f"{where}neighbours.edges", fleet.neighbours, ids)
    slots = [member.slot_enu_m for member in fleet.vehicles]
    for index, slot in enumerate(slots):
        if slot in slots[:index]:
            other = ids[slots.index(slot)]
            raise ConfigError(
                file,
                f"{where}vehicles[{index}].slot_enu_m",
                f"{list(slot)} is also the slot of vehicle {other}; give each its own",
            )
    top_m = fleet.envelope.fence_max_enu_m[2]
    if fleet.takeoff_height_m > top_m:
        raise ConfigError(
            file,
            f"{where}takeoff_height_m",
            f"{fleet.takeoff_height_m:g} is above the fence, which ends at {top_m:g} m",
        )
    for axis, low, high in zip("xyz", fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m, strict=True):
        if low >= high:
            raise ConfigError(
                file,
                f"{where}envelope.fence_min_enu_m",
                f"{axis} is {low}, expected less than fence_max_enu_m's {high}",
            )


def _check_successors(file: Path, where: str, fleet: FleetConfig) -> None:
    may_lead = ", ".join(str(member.id) for member in fleet.vehicles if member.can_lead)
    for index, vehicle_id in enumerate(fleet.successors):
        member = fleet.member(vehicle_id)
        if member is None or not member.can_lead:
            hint = "" if member is None else f", or may_lead: true for vehicle {vehicle_id}"
            raise ConfigError(
                file, f"{where}[{index}]", f"vehicle {vehicle_id} may not lead; expected some of {may_lead}{hint}"
            )
        if vehicle_id in fleet.successors[:index]:
            raise ConfigError(file, f"{where}[{index}]", f"{vehicle_id} is named twice; expected each once, in order")


def _check_edges(file: Path, where: str, neighbours: EdgeNeighbours, ids: list[int]) -> None:
    for index, edge in enumerate(neighbours.edges):
        for vehicle_id in edge:
            if vehicle_id not in ids:
                raise ConfigError(
                    file,
                    f"{where}[{index}]",
                    f"{list(edge)} names vehicle {vehicle_id}, which is not in the fleet; expected two of "
                    + ", ".join(str(i) for i in ids),
                )
        if edge[0] == edge[1]:
            raise ConfigError(
                file, f"{where}[{index}]", f"{list(edge)} joins a vehicle to itself; expected two different ids"
            )


def _check_nobody_cuts(file: Path, where: str, neighbours: EdgeNeighbours, ids: list[int]) -> None:
    """Edges are between vehicles, not between slots: whoever leaves takes its own along, wherever the others move."""
    for gone_id in ids:
        edges = [edge for edge in neighbours.edges if gone_id not in edge]
        rest = [vehicle_id for vehicle_id in ids if vehicle_id != gone_id]
        reached, fresh = set(rest[:1]), set(rest[:1])
        while fresh:
            fresh = {b for edge in edges for a, b in (edge, edge[::-1]) if a in fresh} - reached
            reached |= fresh
        if cut_off := [vehicle_id for vehicle_id in rest if vehicle_id not in reached]:
            raise ConfigError(
                file,
                where,
                f"without vehicle {gone_id}, vehicle {cut_off[0]} is cut off from vehicle {rest[0]}; expected edges that hold"
                " together without any one, or when_one_leaves: keep_gap",
            )


def check_starts(file: Path, fleet: FleetConfig, starts_enu_m: Mapping[int, Vector3]) -> None:
    """A place for every vehicle and for nobody else, and no two in one another. Raises ConfigError."""
    ids = {member.id for member in fleet.vehicles}
    for vehicle_id in sorted(ids - starts_enu_m.keys()):
        raise ConfigError(file, f"starts_enu_m.{vehicle_id}", "missing; every vehicle needs a place to start from")
    for vehicle_id in sorted(starts_enu_m.keys() - ids):
        known = ", ".join(str(i) for i in sorted(ids))
        raise ConfigError(file, f"starts_enu_m.{vehicle_id}", f"no such vehicle in the fleet; expected {known}")
    for i, j in combinations(sorted(ids), 2):
        if (apart_m := dist(starts_enu_m[i], starts_enu_m[j])) < CLOSEST_STARTS_M:
            raise ConfigError(
                file,
                f"starts_enu_m.{j}",
                f"{list(starts_enu_m[j])} is {apart_m:.2f} m from the start of vehicle {i};"
                f" expected at least {CLOSEST_STARTS_M:g} m",
            )
