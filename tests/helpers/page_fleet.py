"""A fleet for tests of the live page: views of vehicles on a figure 8, without agents."""

from __future__ import annotations

from math import ceil, cos, dist, pi, sin, sqrt

from companion.geometry.curves import figure_8
from companion.monitor.api import (
    FleetFileView,
    FleetView,
    MemberView,
    NearestView,
    NeighbourView,
    ObstacleView,
    TimingView,
    VehicleView,
)
from companion.types.status import NetworkState
from companion.types.values import Vector3

SPACING_M = 4.0
ALTITUDE_M = 5.0
SEPARATION_M = 2.5


def slots_of(count: int) -> list[Vector3]:
    """A diamond of four, a grid of more."""
    if count == 4:
        return [(3.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, -3.0, 0.0), (-3.0, 0.0, 0.0)]
    columns = ceil(sqrt(count))
    middle = (columns - 1) / 2.0
    return [((middle - i // columns) * SPACING_M, (middle - i % columns) * SPACING_M, 0.0) for i in range(count)]


def vehicles_at(time_s: float, count: int, fleet: str = "ring") -> list[VehicleView]:
    """All in formation; vehicle 1 leads."""
    scale = max(1.0, sqrt(count) / 3.0)
    (x, y, _), velocity, _ = figure_8(time_s, 24.0 * scale, 12.0 * scale, 60.0 * scale, 5.0)
    centre = (x, y, ALTITUDE_M)
    slots = slots_of(count)
    positions = [_beside(slot, centre, time_s, i) for i, slot in enumerate(slots)]
    return [_vehicle(i, fleet, slots, positions, centre, velocity, time_s) for i in range(count)]


def _beside(slot: Vector3, centre: Vector3, time_s: float, i: int) -> Vector3:
    """The slot with a small wandering error."""
    error_m = 0.12 + 0.08 * sin(0.3 * time_s + i)
    angle = 0.2 * time_s + 2.0 * i
    x, y, z = (s + c for s, c in zip(slot, centre, strict=True))
    return (x + error_m * cos(angle), y + error_m * sin(angle), z + 0.15 * sin(0.15 * time_s + i))


def _vehicle(
    i: int,
    fleet: str,
    slots: list[Vector3],
    positions: list[Vector3],
    centre: Vector3,
    velocity: Vector3,
    time_s: float,
) -> VehicleView:
    position = positions[i]
    slot = tuple(s + c for s, c in zip(slots[i], centre, strict=True))
    others = sorted((dist(position, other), j) for j, other in enumerate(positions) if j != i)
    near = [j for distance_m, j in others[:4] if distance_m < 1.5 * SPACING_M]
    return VehicleView(
        fleet=fleet,
        vehicle_id=i + 1,
        silent=False,
        age_s=0.05,
        data_age_s=0.08 + 0.02 * sin(time_s + i),
        report_rate_hz=10.0,
        phase="formation",
        role="follower" if i else "leader",
        mode="OFFBOARD",
        armed=True,
        landed="in_air",
        position_enu_m=position,
        velocity_enu_m_s=velocity,
        position_error_m=(0.21, 0.34),
        battery_percent=92.0 - 0.02 * time_s - 1.5 * (i % 7),
        law="weighted",
        prc=i + 1 if i < 3 else 3,
        epoch=1,
        leader_id=1,
        leader_beacon_age_s=0.06,
        neighbours=tuple(NeighbourView(j + 1, 1.0 / max(1, len(near)) * (1.4 if j < i else 0.6), 0.04) for j in near),
        peers=tuple(j + 1 for j in range(len(slots)) if j != i),
        slot_position_enu_m=slot,
        slot_offset_enu_m=slots[i],
        error_to_slot_m=dist(position, slot),
        reference_enu_m=None if i else centre,
        formation="2",
        reference="figure 8",
        holder="ground-anna",
        flags=(),
        lacks=(),
        refuses_return=None,
        nearest=NearestView(f"vehicle {others[0][1] + 1}", others[0][0], 2.7, 0.0) if others else None,
        hover_thrust_norm=0.52,
        wind_acceleration_enu_m_s2=(0.3, -0.1, 0.0),
        timing=TimingView(50.0, 0, 0.2, 0.9 + 0.4 * abs(sin(0.4 * time_s + i)), 3.1, 6.0, 11.0, 14.0, 61.0),
        network=NetworkState(security="identity", admission=3),
        rejected=0,
        last_event="FORMATION_CHANGED: formation 2 is flown",
    )


def fleet_of(vehicles: list[VehicleView], name: str = "ring") -> FleetView:
    seen = [vehicle for vehicle in vehicles if not vehicle.silent]
    pairs = [
        (dist(a.position_enu_m, b.position_enu_m), (a.vehicle_id, b.vehicle_id))
        for a in seen
        for b in seen
        if a is not b
    ]
    distance_m, pair = min(pairs) if pairs else (None, None)
    return FleetView(
        name=name,
        vehicle_ids=tuple(vehicle.vehicle_id for vehicle in vehicles),
        missing_ids=(),
        leader_ids=(1,),
        smallest_separation_m=distance_m,
        smallest_separation_pair=pair,
        smallest_separation_unheard=False,
        separation_trend_m_s=-0.04,
        lambda_min=0.382,
        settling_s=6.4,
        link_margin_m=11.5,
        link_margin_pair=(3, 4),
        data_age_worst_s=0.11,
    )


def fleet_file(count: int, name: str = "ring") -> FleetFileView:
    reach_m = 22.0 * max(1.0, sqrt(count) / 3.0)

    def at(*corners: tuple[float, float]) -> tuple[tuple[float, float], ...]:
        return tuple((reach_m * x, reach_m * y) for x, y in corners)

    outline = at((-1.0, -1.0), (1.0, -1.0), (1.0, 0.6), (0.4, 1.0), (-1.0, 1.0))
    angles = [i * pi / 12 for i in range(24)]
    mast = tuple((reach_m * 0.75 + cos(angle), reach_m * 0.45 + sin(angle)) for angle in angles)
    shed = at((-0.9, -0.9), (-0.6, -0.9), (-0.6, -0.7), (-0.9, -0.7))
    slots = slots_of(count)
    return FleetFileView(
        name=name,
        law="weighted",
        origin=(47.397742, 8.545594, 488.0),
        members=tuple(MemberView(i + 1, "follower" if i else "leader", i < 3, slot) for i, slot in enumerate(slots)),
        edges=(),
        range_m=6.0,
        separation_m=SEPARATION_M,
        fence_outline_enu_m=outline,
        fence_floor_m=-5.0,
        fence_ceiling_m=30.0,
        clearance_m=0.5,
        obstacles=(ObstacleView(mast, -10000.0, 18.0), ObstacleView(shed, 0.0, 4.0)),
        homes_enu_m={i + 1: slot for i, slot in enumerate(slots)},
    )
