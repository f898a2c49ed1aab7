"""What a fleet file defines, for the map."""

from __future__ import annotations

from collections.abc import Mapping
from math import cos, pi, sin

from companion.config.fleet import EdgeNeighbours, FleetConfig, RangeNeighbours
from companion.geometry.airspace import Cuboid, Obstacle
from companion.monitor.api import FleetFileView, MemberView, ObstacleView
from companion.types.values import Vector3

CIRCLE_CORNERS = 24
NO_ORIGIN = (0.0, 0.0, 0.0)  # of a fleet indoors: there is no map below it


def fleet_map(fleet: FleetConfig, homes_enu_m: Mapping[int, Vector3]) -> FleetFileView:
    """`homes_enu_m` is where each vehicle was last disarmed on the ground."""
    envelope, neighbours = fleet.envelope, fleet.neighbours
    (low_x, low_y, floor_m), (high_x, high_y, ceiling_m) = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    box = ((low_x, low_y), (high_x, low_y), (high_x, high_y), (low_x, high_y))
    return FleetFileView(
        name=fleet.name,
        law=fleet.law.name,
        origin=NO_ORIGIN if fleet.origin == "indoor" else fleet.origin.as_tuple(),
        members=tuple(MemberView(m.id, m.role, m.can_lead, m.slot_enu_m) for m in fleet.vehicles),
        edges=neighbours.edges if isinstance(neighbours, EdgeNeighbours) else (),
        range_m=neighbours.range_m if isinstance(neighbours, RangeNeighbours) else None,
        separation_m=fleet.separation_m,
        fence_outline_enu_m=envelope.fence_corners_enu_m or box,
        fence_floor_m=floor_m,
        fence_ceiling_m=ceiling_m,
        clearance_m=envelope.clearance_m,
        obstacles=tuple(_obstacle(section.body) for section in fleet.obstacles),
        homes_enu_m=dict(homes_enu_m),
    )


def _obstacle(body: Obstacle) -> ObstacleView:
    if isinstance(body, Cuboid):
        (x0, y0, floor_m), (x1, y1, top_m) = body.min_enu_m, body.max_enu_m
        return ObstacleView(((x0, y0), (x1, y0), (x1, y1), (x0, y1)), floor_m, top_m)
    (x, y), angles = body.centre_enu_m, [2.0 * pi * k / CIRCLE_CORNERS for k in range(CIRCLE_CORNERS)]
    outline = tuple((x + body.radius_m * cos(a), y + body.radius_m * sin(a)) for a in angles)
    return ObstacleView(outline, body.bottom_m, body.top_m)
