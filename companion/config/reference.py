"""The `reference` (RFT) of a vehicle file, a scenario or a command: its kinds, and the curve of each."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.file import convert, read_as
from companion.config.values import Name, PositionM, Section, about
from companion.geometry.curves import Curve, centred_at, circle, figure_8, waypoint_path
from companion.types.values import ZERO3, Vector3

Period = Annotated[float, about("time of a lap at full pace", ge=1, le=3600)]
Ramp = Annotated[float, about("time from rest to full pace", ge=0.1, le=60)]
Speed = Annotated[float, about("largest speed", ge=0.01, le=100)]
Acceleration = Annotated[float, about("largest acceleration", ge=0.01, le=50)]
Size = Annotated[float, Meta(ge=0.01, le=1000)]


class PointReference(Section, frozen=True, tag_field="kind", tag="point"):
    """A fixed point: r = point, r' = 0."""

    point_enu_m: Annotated[PositionM, about("the point")]

    @property
    def start_enu_m(self) -> Vector3:
        return self.point_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        return self.point_enu_m, self.point_enu_m

    def curve(self) -> Curve:
        return lambda _time_s: (self.point_enu_m, ZERO3, ZERO3)


class Figure8Reference(Section, frozen=True, tag_field="kind", tag="figure_8"):
    """A level figure 8 along x, from rest at its centre."""

    centre_enu_m: Annotated[PositionM, about("centre of the 8, where it starts")]
    width_m: Annotated[Size, about("size of the whole 8 along x")]
    height_m: Annotated[Size, about("size of the whole 8 along y")]
    period_s: Period
    ramp_s: Ramp = 5.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.centre_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        return _box_about(self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0)

    def curve(self) -> Curve:
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return centred_at(self.centre_enu_m, lambda time_s: figure_8(time_s, *shape))


class CircleReference(Section, frozen=True, tag_field="kind", tag="circle"):
    """A level circle, counterclockwise, from rest at its easternmost point."""

    centre_enu_m: Annotated[PositionM, about("centre of the circle")]
    radius_m: Annotated[Size, about("radius")]
    period_s: Period
    ramp_s: Ramp = 5.0
    clockwise: Annotated[bool, about("`true`: clockwise, seen from above")] = False

    @property
    def start_enu_m(self) -> Vector3:
        x, y, z = self.centre_enu_m
        return (x + self.radius_m, y, z)

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        return _box_about(self.centre_enu_m, self.radius_m, self.radius_m)

    def curve(self) -> Curve:
        period_s = -self.period_s if self.clockwise else self.period_s
        return centred_at(self.centre_enu_m, lambda time_s: circle(time_s, self.radius_m, period_s, self.ramp_s))


class WaypointsReference(Section, frozen=True, tag_field="kind", tag="waypoints"):
    """Straight lines from point to point, with a stop at each. It starts at the first point and ends at the last."""

    points_enu_m: Annotated[tuple[PositionM, ...], about("the points in order", min_length=1, max_length=200)]
    wait_s: Annotated[float, about("time of the stop at each point", ge=0, le=3600)] = 0.0
    max_speed_m_s: Speed = 2.0
    max_acceleration_m_s2: Acceleration = 1.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.points_enu_m[0]

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        xs, ys, zs = zip(*self.points_enu_m, strict=True)
        return (min(xs), min(ys), min(zs)), (max(xs), max(ys), max(zs))

    def curve(self) -> Curve:
        return waypoint_path(self.points_enu_m, self.wait_s, self.max_speed_m_s, self.max_acceleration_m_s2)


class TargetReference(Section, frozen=True, tag_field="kind", tag="target"):
    """Follows a moving target, which publishes on formation/FLEET/target/NAME. It stays inside the fence by itself."""

    start_enu_m: Annotated[PositionM, about("start, where it waits for the first message of the target")]
    name: Annotated[Name, about("name of the target, NAME of its key")] = "main"
    offset_enu_m: Annotated[PositionM, about("offset of the RFT from the target")] = ZERO3
    follows_altitude: Annotated[bool, about("`true`: z follows the target; `false`: z stays that of the start")] = False
    max_speed_m_s: Speed = 3.0
    max_acceleration_m_s2: Acceleration = 1.0
    max_age_s: Annotated[
        float, about("without a newer message for this time the RFT comes to rest", gt=0.05, le=10)
    ] = 1.0

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The start. After the first message of the target the RFT stays inside the fence by itself."""
        return self.start_enu_m, self.start_enu_m

    def curve(self) -> Curve:
        """The curve without a target: it stays at the start."""
        return lambda _time_s: (self.start_enu_m, ZERO3, ZERO3)


Lapping = Figure8Reference | CircleReference
Reference = PointReference | Figure8Reference | CircleReference | WaypointsReference | TargetReference
FIELD_OF_POSITION: dict[type, str] = {
    PointReference: "point_enu_m",
    Figure8Reference: "centre_enu_m",
    CircleReference: "centre_enu_m",
    WaypointsReference: "points_enu_m",
    TargetReference: "start_enu_m",
}


class ReferenceSection(Section, frozen=True):
    """A file, command line or command with a reference and nothing else."""

    reference: Annotated[Reference, about("the trajectory of the formation (RFT)")]


def load_reference(path: Path) -> Reference:
    """Read a file with a section `reference` and nothing else. Raises ConfigError."""
    return convert(path, read_as(path, "reference"), ReferenceSection).reference


def moves(reference: Reference) -> bool:
    """Whether the reference is anything but a fixed point."""
    return not isinstance(reference, PointReference)


def _box_about(centre_m: Vector3, a_m: float, b_m: float) -> tuple[Vector3, Vector3]:
    x, y, z = centre_m
    return (x - a_m, y - b_m, z), (x + a_m, y + b_m, z)
