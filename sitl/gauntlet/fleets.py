"""Random fleets: size, law, autopilot, sensors, links, separation, slots and starts.

All figures are drawn from one generator, rounded to the millimetre, so that a scenario file holds them exactly.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from math import cos, dist, pi, radians, sin
from random import Random
from typing import Any, Literal

import msgspec

from companion.config.fleet import FleetConfig
from companion.config.law import LawName
from companion.config.planned_flight import DEFAULT_ORIGIN
from companion.geometry.formations import SHAPES, slots_of
from companion.types.autopilot import AutopilotKind
from companion.types.flight import Role
from companion.types.values import Vector3

SensorsName = Literal["ideal", "default", "px4_sih"]
SENSORS: tuple[SensorsName, ...] = ("ideal", "default", "px4_sih")
LAWS: tuple[LawName, ...] = ("weighted", "cooperative")
SEPARATION_M = (1.0, 2.5)
SPACING = (1.3, 2.0)  # of slots, in units of the separation
START_SPACING = 1.3
LEAST_SIGMAS_M: dict[SensorsName, float] = {"ideal": 0.0, "default": 1.5, "px4_sih": 3.0}
"""Smallest spacing with these sensors: agents refuse slots within few sigmas of the reported position errors."""
HEIGHT_M = (2.0, 3.0)
SHAPE_NAMES = tuple(SHAPES)


@dataclass
class DrawnFleet:
    """A drawn fleet. `starts_enu_m` are on the ground; `slots_enu_m` are relative to the reference."""

    size: int
    law: LawName
    autopilot: AutopilotKind
    sensors: SensorsName
    separation_m: float
    spacing_m: float
    height_m: float
    delay_s: float
    jitter_s: float
    loss: float
    seed: int
    slot_speed_m_s: float
    slots_enu_m: dict[int, Vector3]
    starts_enu_m: dict[int, Vector3] = field(default_factory=dict)
    own: FleetConfig | None = None  # a user's fleet, flown with its own settings

    @property
    def ids(self) -> list[int]:
        return sorted(self.slots_enu_m)

    @property
    def leader(self) -> int:
        """The first leader at the start; a drawn fleet is led by vehicle 1."""
        return min(m.id for m in self.own.vehicles if m.role is Role.LEADER) if self.own else 1

    @property
    def successor(self) -> int:
        """A vehicle that may lead next; of a fleet without one its leader."""
        if self.own is None:
            return 2
        return next((m.id for m in self.own.vehicles if m.can_lead and m.id != self.leader), self.leader)

    @property
    def followers(self) -> list[int]:
        """All but the leader."""
        return [i for i in self.ids if i != self.leader]


def random_fleet(random: Random, sensors: SensorsName | None = None, own: FleetConfig | None = None) -> DrawnFleet:
    """A fleet that starts below its slots, with the reference at x = y = 0; with `own` only its surroundings are random."""
    size, law = min(random.randint(4, 12), random.randint(4, 12)), random.choice(LAWS)
    autopilot = random.choice(tuple(AutopilotKind))
    drawn_sensors = random.choice(SENSORS)
    used_sensors = sensors or drawn_sensors
    separation_m = to_thousandth(random.uniform(*SEPARATION_M))
    spacing_m = to_thousandth(max(separation_m * random.uniform(*SPACING), LEAST_SIGMAS_M[used_sensors]))
    good_network = random.random() < 0.3
    delay_s, jitter_s, loss = random.uniform(0.0, 0.1), random.uniform(0.0, 0.05), random.uniform(0.0, 0.1)
    fleet = DrawnFleet(
        size=size,
        law=law,
        autopilot=autopilot,
        sensors=used_sensors,
        separation_m=separation_m,
        spacing_m=spacing_m,
        height_m=to_thousandth(random.uniform(*HEIGHT_M)),
        delay_s=0.001 if good_network else to_thousandth(max(delay_s - jitter_s, 0.0)),
        jitter_s=0.0 if good_network else to_thousandth(jitter_s),
        loss=0.0 if good_network else to_thousandth(loss),
        seed=random.randrange(1_000_000),
        slots_enu_m={},
        slot_speed_m_s=to_thousandth(random.uniform(1.0, 2.0)),
        own=own,
    )
    fleet.slots_enu_m = random_slots(random, fleet)
    if own is not None:
        _take_settings(fleet, own)
    fleet.starts_enu_m = below(fleet.slots_enu_m, fleet)
    return fleet


def _take_settings(fleet: DrawnFleet, own: FleetConfig) -> None:
    """Size, law, separation, slots and heights of the user's fleet."""
    fleet.size, fleet.law, fleet.separation_m = len(own.vehicles), own.law.name, own.separation_m
    fleet.height_m, fleet.slot_speed_m_s = own.takeoff_height_m, own.slot_speed_m_s
    fleet.slots_enu_m = {member.id: member.slot_enu_m for member in own.vehicles}
    slots = list(fleet.slots_enu_m.values())
    fleet.spacing_m = to_thousandth(min((dist(a, b) for a, b in combinations(slots, 2)), default=own.separation_m))


def random_slots(random: Random, fleet: DrawnFleet) -> dict[int, Vector3]:
    """The slots of a random shape with a random heading by vehicle id."""
    shape = random.choice(SHAPE_NAMES)
    heading_rad = radians(random.choice((0.0, 0.0, random.uniform(-180.0, 180.0))))
    slots = slots_of(SHAPES[shape], fleet.size, fleet.spacing_m, heading_rad)
    return {i: on_grid(slot) for i, slot in enumerate(slots, start=1)}


def below(slots_enu_m: Mapping[int, Vector3], fleet: DrawnFleet) -> dict[int, Vector3]:
    """Starts below the slots, moved apart where slots are above each other."""
    flat = {i: (x, y) for i, (x, y, _) in slots_enu_m.items()}
    nearest_m = min(dist(a, b) for a, b in combinations(flat.values(), 2))
    scale = max(1.0, START_SPACING * fleet.separation_m / max(nearest_m, 0.1))
    return {i: on_grid((scale * x, scale * y, 0.0)) for i, (x, y) in flat.items()}


def scattered(random: Random, count: int, apart_m: float, taken: Sequence[Vector3] = ()) -> list[Vector3]:
    """Random points on the ground in a field, at least `apart_m` from each other and from those taken."""
    points: list[Vector3] = []
    side_m = 1.6 * apart_m * count**0.5
    while len(points) < count:
        side_m *= 1.002  # a field that is too small grows
        x, y = random.uniform(-side_m / 2.0, side_m / 2.0), random.uniform(-side_m / 2.0, side_m / 2.0)
        point = on_grid((x, y, 0.0))
        if all(dist(point[:2], other[:2]) >= apart_m for other in (*points, *taken)):
            points.append(point)
    return points


def direction(random: Random, length_m: float) -> Vector3:
    """A random level vector of this length."""
    angle_rad = random.uniform(0.0, 2.0 * pi)
    return on_grid((length_m * cos(angle_rad), length_m * sin(angle_rad), 0.0))


def moved(point: Vector3, by: Vector3) -> Vector3:
    return on_grid((point[0] + by[0], point[1] + by[1], point[2] + by[2]))


def to_thousandth(value: float) -> float:
    return round(value, 3)


def on_grid(point: Sequence[float]) -> Vector3:
    x, y, z = point
    return (to_thousandth(x), to_thousandth(y), to_thousandth(z))


def sections(fleet: DrawnFleet, random: Random) -> dict[str, Any]:
    """The scenario of the fleet as plain content, still without reference and timeline."""
    roles = dict.fromkeys(fleet.ids, "follower") | {fleet.leader: "leader"}
    may_lead = (fleet.leader, fleet.successor)
    vehicles = [
        {"id": i, "role": roles[i], "slot_enu_m": list(slot), "may_lead": i in may_lead}
        for i, slot in fleet.slots_enu_m.items()
    ]
    settings: dict[str, Any] = {
        "name": "gauntlet",
        "vehicles": vehicles,
        "law": {"name": fleet.law},
        "separation_m": fleet.separation_m,
        "takeoff_height_m": fleet.height_m,
        "successors": [fleet.successor],
        "slot_speed_m_s": fleet.slot_speed_m_s,
        "when_one_leaves": random.choice(("keep_gap", "close_up")),
    }
    if random.random() < 0.5:
        pairs = [[i, i + step] for step in (1, 2) for i in fleet.ids if i + step <= fleet.size]
        settings["neighbours"] = {"kind": "edges", "edges": pairs}
    if fleet.own is not None:
        settings = msgspec.to_builtins(fleet.own)
        settings["origin"] = msgspec.to_builtins(DEFAULT_ORIGIN)
    return {
        "fleet": settings,
        "starts_enu_m": {i: list(start) for i, start in fleet.starts_enu_m.items()},
        "stand_in": {
            "autopilot": str(fleet.autopilot),
            "sensors": fleet.sensors,
            "seed": fleet.seed,
            "armable_after_s": 0.5,
        },
        "links": {"peer_delay_s": fleet.delay_s, "peer_jitter_s": fleet.jitter_s, "peer_loss": fleet.loss},
    }
