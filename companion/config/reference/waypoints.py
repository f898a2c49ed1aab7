"""Straight lines from point to point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import ceil, dist
from typing import Annotated, ClassVar, Self

from msgspec import Meta

from companion.config.reference.base import ACCELERATION, CRUISE_M_S, SPEED, Asked, LimitedReference, Speed
from companion.config.values import PositionM
from companion.geometry.curves import (
    Curve,
    Harmonic,
    duration_s,
    leg_harmonics,
    moving_legs,
    peak_pace,
    waypoint_path,
)
from companion.types.values import Vector3


class WaypointsReference(LimitedReference, frozen=True, tag_field="kind", tag="waypoints"):
    """Straight lines from point to point, with a stop at each. It starts at the first point and ends at the last.

    points_enu_m: the points in order
    wait_s: time of the stop at each point
    """

    TITLE, POSITION, MOST_POSITIONS = "Waypoints", "points_enu_m", 200
    ASKED: ClassVar[Mapping[str, Asked]] = {
        "max_speed_m_s": SPEED,
        "wait_s": Asked("--pause", "at each waypoint, seconds", "Stop at each"),
        "max_acceleration_m_s2": ACCELERATION,
    }

    points_enu_m: Annotated[tuple[PositionM, ...], Meta(min_length=1, max_length=200)]
    wait_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    max_speed_m_s: Speed = 2.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.points_enu_m[0]

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        xs, ys, zs = zip(*self.points_enu_m, strict=True)
        return (min(xs), min(ys), min(zs)), (max(xs), max(ys), max(zs))

    def curve(self) -> Curve:
        return waypoint_path(self.points_enu_m, self.wait_s, *self.limits)

    def legs_enu_m(self) -> Sequence[tuple[Vector3, Vector3]]:
        return list(pairwise(self.points_enu_m)) or [(self.start_enu_m, self.start_enu_m)]

    def largest_pace(self) -> tuple[float, float]:
        paces = [peak_pace(leg_m, duration_s(leg_m, *self.limits)) for *_, leg_m in moving_legs(self.points_enu_m)]
        return max((pace[0] for pace in paces), default=0.0), max((pace[1] for pace in paces), default=0.0)

    def whole_s(self) -> float:
        """All legs."""
        legs_s = [duration_s(dist(a, b), *self.limits) + self.wait_s for a, b in pairwise(self.points_enu_m)]
        return float(ceil(sum(legs_s) + 5.0))

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """One for each leg with another direction or pace: the harmonic with its largest speed and acceleration."""
        return [[harmonic] for harmonic in leg_harmonics(self.points_enu_m, self.limits, slots_turn)]

    @classmethod
    def first(cls, size_m: float, height_m: float) -> Self:
        """A square."""
        corners = ((0.0, 0.0), (size_m, 0.0), (size_m, size_m), (0.0, size_m), (0.0, 0.0))
        points = tuple((x, y, height_m) for x, y in corners)
        return cls(points_enu_m=points, wait_s=3.0, max_speed_m_s=CRUISE_M_S)


KIND = WaypointsReference
