"""YAML files -> validated frozen types. Every error is one line: file, field, value, what was expected.

A fleet file holds what all vehicles must agree on; its hash travels with every peer packet. A vehicle file holds what is
one vehicle's own and names its fleet file. Only the file of a vehicle that may lead holds a reference (RFT).
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from math import dist, hypot, pi, radians, sqrt, tan
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from msgspec import Meta, Struct
from msgspec.structs import replace

from companion.config_file import ConfigError, convert, read_yaml
from companion.figure_8 import figure_8
from companion.types import GRAVITY_M_S2, AutopilotKind, Role, Vector3

FLEET_NAME = "^[a-z0-9][a-z0-9_-]{0,40}$"  # it is a part of Zenoh's key expressions
FLEET_NAME_WORDS = "at most 41 lower-case letters, digits, - and _, a letter or digit first"
VehicleId = Annotated[int, Meta(ge=1, le=250, description="MAVLink system id of the vehicle")]
Seconds = Annotated[float, Meta(gt=0, le=60)]
Coordinate = Annotated[float, Meta(ge=-10_000, le=10_000)]
PositionM = tuple[Coordinate, Coordinate, Coordinate]
LAP_SAMPLES = 2000
CLOSEST_STARTS_M = 0.3  # nearer, two vehicles stand in one another
MAX_DRAG_1_S = 10.0
HoverThrust = Annotated[float, Meta(ge=0.1, le=0.9)]
Drag = Annotated[float, Meta(ge=0, le=MAX_DRAG_1_S, description="deceleration by drag for each m/s through the air")]


class _Base(Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    pass


# ---------------------------------------------------------------- fleet file


class GeodeticOrigin(_Base, frozen=True):
    """Where the fleet frame (ENU) has its zero."""

    latitude_deg: Annotated[float, Meta(ge=-85, le=85)]
    longitude_deg: Annotated[float, Meta(ge=-180, le=180)]
    altitude_amsl_m: Annotated[float, Meta(ge=-500, le=9000)]

    def as_tuple(self) -> Vector3:
        return (self.latitude_deg, self.longitude_deg, self.altitude_amsl_m)


class FormationMember(_Base, frozen=True):
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


Gain = Annotated[float, Meta(gt=0, le=10)]


class Gains(_Base, frozen=True):
    """K = [k1, k2] of eq. 14: k1 on position [1/s^2], k2 on velocity [1/s]. What is None is as the law has it."""

    position_1_s2: Gain | None = None
    velocity_1_s: Gain | None = None


class AltitudeHoldGains(_Base, frozen=True):
    """Of a vehicle that holds its own altitude: on position [1/s^2] and on velocity [1/s]."""

    position_1_s2: Gain = 2.0
    velocity_1_s: Gain = 2.4


LawName = Literal["cooperative", "weighted", "average_22", "average_26"]
PAPER_LAWS: tuple[LawName, ...] = ("weighted", "average_22", "average_26")


class Law(_Base, frozen=True):
    """Which formation law flies, and what of it is changed; what is left out is as the law of that name has it.

    `weighted` is the paper's, `average_22` and `average_26` are what it is compared with, `cooperative` is the one to fly.
    `exponent` is alpha of the weights 1/p^alpha (1 is the paper's Algorithm 2), `feedforward` how much of the neighbours'
    acceleration is fed forward, and without `leader_heeds_neighbours` a leader tracks its reference alone.
    `disturbance_bandwidth_1_s` is how fast wind and a wrong hover thrust are found and made up for; 0 leaves them to the law.
    """

    name: LawName = "cooperative"
    gains: Gains = Gains()
    exponent: Annotated[float, Meta(ge=0, le=16)] | None = None
    feedforward: Annotated[float, Meta(ge=0, le=0.95)] | None = None
    leader_heeds_neighbours: bool | None = None
    altitude: Literal["formation", "hold"] = "formation"
    altitude_hold_gains: AltitudeHoldGains = AltitudeHoldGains()
    disturbance_bandwidth_1_s: Annotated[float, Meta(ge=0, le=5)] = 4.0

    def renamed(self, name: LawName) -> Law:
        """For comparisons: another law in this one's place. The paper's three are compared with the same gains."""
        if name == self.name:
            return self
        same_gains = name in PAPER_LAWS and self.name in PAPER_LAWS
        return replace(
            self,
            name=name,
            gains=self.gains if same_gains else Gains(),
            exponent=None,
            feedforward=None,
            leader_heeds_neighbours=None,
        )


class RangeNeighbours(_Base, frozen=True, tag_field="kind", tag="range"):
    """A vehicle becomes a neighbour within `range_m` and stays one until it is `hysteresis_m` farther away."""

    range_m: Annotated[float, Meta(gt=0, le=10_000)]
    hysteresis_m: Annotated[float, Meta(ge=0, le=1_000)] = 0.0


class EdgeNeighbours(_Base, frozen=True, tag_field="kind", tag="edges"):
    """Neighbours are given as undirected edges between vehicle ids."""

    edges: tuple[tuple[VehicleId, VehicleId], ...]


class PeerLimits(_Base, frozen=True):
    """What is believed of a peer, and for how long."""

    max_age_s: Annotated[float, Meta(gt=0.02, le=5)] = 0.3
    leader_word_max_age_s: Annotated[float, Meta(gt=0.02, le=10)] = 0.5
    max_speed_m_s: Annotated[float, Meta(gt=0, le=100)] = 25.0


class Envelope(_Base, frozen=True):
    """The last gate's limits. The fence is a box in the fleet frame."""

    max_tilt_deg: Annotated[float, Meta(gt=0, le=45)] = 25.0
    max_tilt_rate_deg_s: Annotated[float, Meta(gt=0, le=1000)] = 400.0
    min_thrust_ratio: Annotated[float, Meta(gt=0, lt=1)] = 0.3  # of hover thrust
    max_thrust_ratio: Annotated[float, Meta(gt=1, le=4)] = 1.6
    max_thrust_rate_1_s: Annotated[float, Meta(gt=0, le=100)] = 10.0  # hover thrusts per second
    fence_min_enu_m: PositionM = (-100.0, -100.0, -5.0)
    fence_max_enu_m: PositionM = (100.0, 100.0, 50.0)


class FleetConfig(_Base, frozen=True):
    """What all vehicles of a fleet must agree on.

    `origin` is `indoor` where one motion-capture system gives all vehicles one frame. `altitude_source` says where z is
    zero: at the origin's altitude (indoors the shared frame's zero), or, with `takeoff`, where each vehicle stood when it
    was armed, for fleets that start from level ground. Only vehicles that stand within `ground_spread_m` of each other in
    altitude take off.
    """

    name: Annotated[str, Meta(pattern=FLEET_NAME, description=FLEET_NAME_WORDS)]
    origin: GeodeticOrigin | Literal["indoor"]
    vehicles: tuple[FormationMember, ...]
    neighbours: EdgeNeighbours | RangeNeighbours
    altitude_source: Literal["origin", "takeoff"] = "origin"
    ground_spread_m: Annotated[float, Meta(gt=0, le=1000)] = 1.0
    law: Law = Law()
    takeoff_height_m: Annotated[float, Meta(ge=0.5, le=120)] = 2.5
    peers: PeerLimits = PeerLimits()
    envelope: Envelope = Envelope()

    def formation_hash(self) -> int:
        """64 bits over everything in this file: two vehicles fly together only where it is the same."""
        digest = hashlib.sha256(msgspec.json.encode(self, order="sorted")).digest()
        return int.from_bytes(digest[:8], "big")

    def member(self, vehicle_id: int) -> FormationMember | None:
        return next((m for m in self.vehicles if m.id == vehicle_id), None)


# ---------------------------------------------------------------- vehicle file


class PointReference(_Base, frozen=True, tag_field="kind", tag="point"):
    """RFT that stands still, r = point, r' = 0."""

    point_enu_m: PositionM

    @property
    def start_enu_m(self) -> Vector3:
        return self.point_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        return self.point_enu_m, self.point_enu_m


class Figure8Reference(_Base, frozen=True, tag_field="kind", tag="figure_8"):
    """RFT on a level 8 along x that begins at its centre with zero speed and gets up to its pace within `ramp_s`.

    `period_s` is a lap's time at full pace.
    """

    centre_enu_m: PositionM
    width_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along x")]
    height_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along y")]
    period_s: Annotated[float, Meta(ge=1, le=3600)]
    ramp_s: Seconds = 5.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.centre_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        (x, y, z), a, b = self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0
        return (x - a, y - b, z), (x + a, y + b, z)

    def largest_speed_m_s(self) -> float:
        """At the centre."""
        return 2.0 * pi / self.period_s * hypot(self.width_m / 2.0, self.height_m)

    def largest_acceleration_m_s2(self) -> float:
        """While it gets up to its pace and on the first full lap."""
        times_s = (index / LAP_SAMPLES * (self.ramp_s + self.period_s) for index in range(LAP_SAMPLES))
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return max(hypot(*figure_8(time_s, *shape)[2]) for time_s in times_s)


Reference = PointReference | Figure8Reference


class ZenohEndpoints(_Base, frozen=True):
    """Explicit endpoints, like "tcp/192.168.1.11:7447". Multicast scouting stays off."""

    listen: tuple[str, ...] = ()
    connect: tuple[str, ...] = ()


class Signing(_Base, frozen=True):
    """MAVLink 2 signing between agent and autopilot, which needs the same key.

    One of `key_file` (a path, relative to the vehicle file) and `credential` (of the systemd service, by LoadCredential).
    """

    key_file: str | None = None
    credential: (
        Annotated[str, Meta(pattern="^[A-Za-z0-9_.-]+$", description="a name of letters, digits, _, . and -")] | None
    ) = None
    link_id: Annotated[int, Meta(ge=0, le=255)] = 0


class VehicleConfig(_Base, frozen=True):
    """What is one vehicle's own.

    `mavlink`: "udpin:HOST:PORT" (listen), "tcp:HOST:PORT" (connect) or "serial:DEVICE:BAUD".
    `fleet`: path of the fleet file, relative to this file.
    `autopilot`: whose manners it must have; where it is left out its HEARTBEAT says so.
    `ground_station`: "udpout:HOST:PORT", where the autopilot's MAVLink is passed on to.
    `hover_thrust_norm` is where the agent begins; it finds the right one in flight, as far as the fleet's law lets it.
    `drag_1_s`: drag per mass and speed, which damps the vehicle and is left to do that. Too low a number takes some of this
    damping away, and the formation swings a little; too high a number adds some. 0.25 is of a small open quadrotor.
    """

    id: VehicleId
    fleet: str
    mavlink: Annotated[
        str,
        Meta(
            pattern="^(udpin|tcp|serial):.+:[0-9]+$",
            description="udpin:HOST:PORT, tcp:HOST:PORT or serial:DEVICE:BAUD, like serial:/dev/ttyAMA0:921600",
        ),
    ]
    hover_thrust_norm: HoverThrust
    drag_1_s: Drag = 0.25
    autopilot: AutopilotKind | None = None
    zenoh: ZenohEndpoints = ZenohEndpoints()
    reference: Reference | None = None
    signing: Signing | None = None
    ground_station: Annotated[
        str, Meta(pattern="^(udpout:.+:[0-9]{1,9})?$", description="udpout:HOST:PORT, like udpout:192.168.1.50:14550")
    ] = ""


# ---------------------------------------------------------------- which of the files is it?

FileKind = Literal["scenario", "vehicle", "fleet"]
KEYS_OF_KIND: dict[FileKind, set[str]] = {  # no other kind of file has these
    "scenario": {"starts_enu_m", "timeline"},
    "vehicle": {"mavlink", "hover_thrust_norm"},
    "fleet": {"vehicles", "neighbours", "takeoff_height_m"},
}
A_FILE: dict[FileKind, str] = {"scenario": "a scenario", "vehicle": "a vehicle file", "fleet": "a fleet file"}


def kind_of_file(data: Any) -> FileKind | None:
    """By the keys that it has; None where they do not tell."""
    kinds = [kind for kind, keys in KEYS_OF_KIND.items() if isinstance(data, dict) and keys & data.keys()]
    return kinds[0] if len(kinds) == 1 else None


def read_as(path: Path, *expected: FileKind) -> Any:
    """The plain content of a YAML file. Raises ConfigError, also for a file of another kind."""
    data = read_yaml(path)
    kind = kind_of_file(data)
    if kind is not None and kind not in expected:
        wanted = " or ".join(A_FILE[kind] for kind in expected)
        raise ConfigError(path, "", f"this is {A_FILE[kind]}; {wanted} is expected")
    return data


# ---------------------------------------------------------------- what no single field can say


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
    _check_law(file, f"{where}law", fleet.law)
    if isinstance(fleet.neighbours, EdgeNeighbours):
        _check_edges(file, f"{where}neighbours.edges", fleet.neighbours, ids)
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


def _check_law(file: Path, where: str, law: Law) -> None:
    """The average laws are what they are; anything else would be the weighted law with another exponent."""
    if law.name not in ("average_22", "average_26"):
        return
    for field in ("exponent", "feedforward", "leader_heeds_neighbours"):
        if getattr(law, field) is not None:
            raise ConfigError(
                file,
                f"{where}.{field}",
                f"{law.name} takes no {field}; take it out, or fly weighted (its average is exponent: 0)",
            )


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


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """A vehicle file together with its fleet file, checked against each other."""

    vehicle: VehicleConfig
    fleet: FleetConfig
    member: FormationMember


def load_agent(path: Path) -> AgentConfig:
    """Read a vehicle file and the fleet file that it names. Raises ConfigError."""
    vehicle = convert(path, read_as(path, "vehicle"), VehicleConfig)
    _check_signing(path, vehicle.signing)
    fleet_path = path.parent / vehicle.fleet
    if not fleet_path.is_file():
        where = f"looked for {fleet_path}; the path is relative to the vehicle file"
        raise ConfigError(path, "fleet", f'"{vehicle.fleet}": no such file; {where}')
    fleet = convert(fleet_path, read_as(fleet_path, "fleet"), FleetConfig)
    check_fleet(fleet_path, fleet)
    member = fleet.member(vehicle.id)
    if member is None:
        ids = ", ".join(str(m.id) for m in fleet.vehicles)
        raise ConfigError(path, "id", f"{vehicle.id} has no slot in {fleet_path}; expected one of {ids}")
    if member.can_lead and vehicle.reference is None:
        leads = "leads" if member.role is Role.LEADER else "may lead"
        raise ConfigError(
            path, "reference", f"missing; vehicle {vehicle.id} {leads} and needs the reference trajectory (RFT)"
        )
    if not member.can_lead and vehicle.reference is not None:
        raise ConfigError(
            path,
            "reference",
            f"vehicle {vehicle.id} follows; only a leader may know the RFT, take this section out"
            f" (or let it lead: may_lead: true in {fleet_path})",
        )
    if vehicle.reference is not None:
        check_reference(path, fleet, vehicle.reference)
    return AgentConfig(vehicle, fleet, member)


def _check_signing(file: Path, signing: Signing | None) -> None:
    if signing is not None and (signing.key_file is None) == (signing.credential is None):
        raise ConfigError(file, "signing", "expected one of key_file and credential, where the key is")


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


def check_reference(file: Path, fleet: FleetConfig, reference: Reference) -> None:
    """Every vehicle's place r + d_i0 lies inside the fence all along, and the fleet can fly it. Raises ConfigError."""
    envelope = fleet.envelope
    lowest, highest = reference.corners_enu_m()
    field = "centre_enu_m" if isinstance(reference, Figure8Reference) else "point_enu_m"
    for member in fleet.vehicles:
        for axis, least, most, d, low, high in zip(
            "xyz",
            lowest,
            highest,
            member.slot_enu_m,
            envelope.fence_min_enu_m,
            envelope.fence_max_enu_m,
            strict=True,
        ):
            for r in (least, most):
                if not low <= r + d <= high:
                    raise ConfigError(
                        file,
                        f"reference.{field}",
                        f"puts vehicle {member.id} at {axis} = {r + d:g} m, outside the fence ({low:g} to {high:g})",
                    )
    if isinstance(reference, Figure8Reference):
        _check_pace(file, fleet, reference)


def _check_pace(file: Path, fleet: FleetConfig, reference: Figure8Reference) -> None:
    """An 8 that is too fast cannot be flown, or its flyers are not believed."""
    most_m_s2 = GRAVITY_M_S2 * tan(radians(fleet.envelope.max_tilt_deg))
    slower = sqrt(reference.largest_acceleration_m_s2() / most_m_s2)
    if slower > 1.0:
        raise ConfigError(
            file,
            "reference.period_s",
            f"{reference.period_s:g} s with ramp_s {reference.ramp_s:g} asks for"
            f" {reference.largest_acceleration_m_s2():.1f} m/s^2, envelope.max_tilt_deg {fleet.envelope.max_tilt_deg:g} gives"
            f" {most_m_s2:.1f}; expected at least {reference.period_s * slower + 0.05:.1f} s with ramp_s"
            f" {reference.ramp_s * slower + 0.05:.1f}, or a smaller figure",
        )
    speed_m_s, believed_m_s = reference.largest_speed_m_s(), fleet.peers.max_speed_m_s
    if speed_m_s > believed_m_s:
        raise ConfigError(
            file,
            "reference.period_s",
            f"{reference.period_s:g} s asks for {speed_m_s:.1f} m/s, peers.max_speed_m_s believes {believed_m_s:g};"
            f" expected at least {reference.period_s * speed_m_s / believed_m_s + 0.05:.1f} s, or a smaller figure",
        )
