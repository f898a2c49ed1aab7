"""A `reference` of a vehicle file, a scenario or a command: where the RFT leads, and whether that can be flown."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from math import dist, floor, hypot, radians, tan
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from companion.config.fleet import FLEET_NAME, FLEET_NAME_WORDS, FleetConfig
from companion.config.kind import read_as
from companion.config.values import PositionM, Seconds, Section
from companion.config_file import ConfigError, convert
from companion.geometry.curves import PEAK_ACCELERATION, PEAK_SPEED, Curve, about, circle, duration_s, figure_8, way
from companion.geometry.turning import SLOT_ACCELERATION_M_S2, course, reach_m, swept, turn_limits
from companion.types import GRAVITY_M_S2, ZERO3, Vector3

RAMP_SAMPLES, LAP_SAMPLES = 100, 500
ROUNDED = 1.0 + 1e-9  # a limit that is met exactly is met

Period = Annotated[float, Meta(ge=1, le=3600)]
Speed = Annotated[float, Meta(gt=0, le=100)]
Acceleration = Annotated[float, Meta(gt=0, le=50)]


class PointReference(Section, frozen=True, tag_field="kind", tag="point"):
    """RFT that stands still, r = point, r' = 0."""

    point_enu_m: PositionM

    @property
    def start_enu_m(self) -> Vector3:
        return self.point_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        return self.point_enu_m, self.point_enu_m

    def curve(self) -> Curve:
        return lambda _time_s: (self.point_enu_m, ZERO3, ZERO3)


class Figure8Reference(Section, frozen=True, tag_field="kind", tag="figure_8"):
    """RFT on a level 8 along x that begins at its centre with zero speed and gets up to its pace within `ramp_s`.

    `period_s` is a lap's time at full pace.
    """

    centre_enu_m: PositionM
    width_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along x")]
    height_m: Annotated[float, Meta(gt=0, le=1000, description="of the whole 8, along y")]
    period_s: Period
    ramp_s: Seconds = 5.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.centre_enu_m

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        return _box_about(self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0)

    def curve(self) -> Curve:
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return about(self.centre_enu_m, lambda time_s: figure_8(time_s, *shape))


class CircleReference(Section, frozen=True, tag_field="kind", tag="circle"):
    """RFT on a level circle, counterclockwise, that begins in the east with zero speed; its pace is given as that of an 8."""

    centre_enu_m: PositionM
    radius_m: Annotated[float, Meta(gt=0, le=1000)]
    period_s: Period
    ramp_s: Seconds = 5.0
    clockwise: bool = False

    @property
    def start_enu_m(self) -> Vector3:
        x, y, z = self.centre_enu_m
        return (x + self.radius_m, y, z)

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        return _box_about(self.centre_enu_m, self.radius_m, self.radius_m)

    def curve(self) -> Curve:
        period_s = -self.period_s if self.clockwise else self.period_s
        return about(self.centre_enu_m, lambda time_s: circle(time_s, self.radius_m, period_s, self.ramp_s))


class WaypointsReference(Section, frozen=True, tag_field="kind", tag="waypoints"):
    """RFT straight from point to point, the first of them its beginning. At each it stops and waits, at the last it stays."""

    points_enu_m: Annotated[tuple[PositionM, ...], Meta(min_length=1, max_length=200)]
    wait_s: Annotated[float, Meta(ge=0, le=3600)] = 0.0
    max_speed_m_s: Speed = 2.0
    max_acceleration_m_s2: Acceleration = 1.0

    @property
    def start_enu_m(self) -> Vector3:
        return self.points_enu_m[0]

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """The box that it never leaves: lowest and highest coordinates."""
        xs, ys, zs = zip(*self.points_enu_m, strict=True)
        return (min(xs), min(ys), min(zs)), (max(xs), max(ys), max(zs))

    def curve(self) -> Curve:
        return way(self.points_enu_m, self.wait_s, self.max_speed_m_s, self.max_acceleration_m_s2)


class TargetReference(Section, frozen=True, tag_field="kind", tag="target"):
    """RFT that follows what somebody publishes on formation/FLEET/target/NAME (`name`), within these limits.

    It begins at `start_enu_m` and waits there until a target is heard; when it falls silent for `max_age_s`, it comes to rest.
    Its altitude is the start's, unless it `follows_altitude`; its place is `offset_enu_m` from the target.
    """

    start_enu_m: PositionM
    name: Annotated[str, Meta(pattern=FLEET_NAME, description=FLEET_NAME_WORDS)] = "main"
    offset_enu_m: PositionM = ZERO3
    follows_altitude: bool = False
    max_speed_m_s: Speed = 3.0
    max_acceleration_m_s2: Acceleration = 1.0
    max_age_s: Annotated[float, Meta(gt=0.05, le=10)] = 1.0

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Where it is before a target is heard; after that it stays inside the fence by itself."""
        return self.start_enu_m, self.start_enu_m

    def curve(self) -> Curve:
        """As long as no target is heard."""
        return lambda _time_s: (self.start_enu_m, ZERO3, ZERO3)


Lapping = Figure8Reference | CircleReference
Reference = PointReference | Figure8Reference | CircleReference | WaypointsReference | TargetReference
FIELD_OF_PLACE: dict[type, str] = {
    PointReference: "point_enu_m",
    Figure8Reference: "centre_enu_m",
    CircleReference: "centre_enu_m",
    WaypointsReference: "points_enu_m",
    TargetReference: "start_enu_m",
}


class ReferenceSection(Section, frozen=True):
    """A reference by itself: what a file of one holds, what a command line says, and what a command brings."""

    reference: Reference


def load_reference(path: Path) -> Reference:
    """Read a file with a section `reference` and nothing else. Raises ConfigError."""
    return convert(path, read_as(path, "reference"), ReferenceSection).reference


def moves(reference: Reference) -> bool:
    return not isinstance(reference, PointReference)


def most_pace(fleet: FleetConfig) -> tuple[float, float]:
    """The speed [m/s] that is believed, and the acceleration [m/s^2] that the largest tilt gives in level flight.

    Less what slots need that turn about the RFT.
    """
    speed_m_s, acceleration_m_s2 = fleet.peers.max_speed_m_s, GRAVITY_M_S2 * tan(radians(fleet.envelope.max_tilt_deg))
    if fleet.slots_turn:
        return speed_m_s - fleet.slot_speed_m_s, acceleration_m_s2 - SLOT_ACCELERATION_M_S2
    return speed_m_s, acceleration_m_s2


def largest_pace(reference: Reference) -> tuple[float, float]:
    """The largest speed [m/s] and acceleration [m/s^2] that it asks for at any time; a target's by its limits."""
    match reference:
        case PointReference():
            return 0.0, 0.0
        case TargetReference():
            return reference.max_speed_m_s, reference.max_acceleration_m_s2
        case WaypointsReference():
            return _largest_pace_of_legs(reference)
        case Figure8Reference() | CircleReference():
            curve = reference.curve()
            motions = [curve(time_s) for time_s in _ramp_and_lap_s(reference)]
            return max(hypot(*m[1]) for m in motions), max(hypot(*m[2]) for m in motions)


def check_reference(
    file: Path,
    fleet: FleetConfig,
    reference: Reference,
    where: str = "",
    slots_enu_m: Mapping[int, Vector3] | None = None,
) -> None:
    """Every vehicle's place r + d_i0 lies inside the fence all along, and the fleet can fly it. Raises ConfigError.

    `slots_enu_m` are those of the formation flown, where it is not the fleet file's; `where` its section's section.
    """
    slots = slots_enu_m or {member.id: member.slot_enu_m for member in fleet.vehicles}
    _check_places(file, f"{where}reference", fleet, reference, slots)
    if moves(reference):
        _check_pace(file, f"{where}reference", fleet, reference)
    if fleet.slots_turn and isinstance(reference, Lapping):
        _check_turns(file, f"{where}reference", fleet, reference, slots)


def _check_places(
    file: Path, section: str, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3]
) -> None:
    lowest, highest = reference.corners_enu_m()
    fence = (fleet.envelope.fence_min_enu_m, fleet.envelope.fence_max_enu_m)
    taken = {i: swept([slot_enu_m]) if fleet.slots_turn else [slot_enu_m] for i, slot_enu_m in slots_enu_m.items()}
    for vehicle_id, slot_enu_m in ((i, corner) for i, corners in taken.items() for corner in corners):
        for axis, least, most, d, low, high in zip("xyz", lowest, highest, slot_enu_m, *fence, strict=True):
            for r in (least, most):
                if not low <= r + d <= high:
                    raise ConfigError(
                        file,
                        f"{section}.{FIELD_OF_PLACE[type(reference)]}",
                        f"puts vehicle {vehicle_id} at {axis} = {r + d:g} m, outside the fence ({low:g} to {high:g})",
                    )


def _check_pace(file: Path, section: str, fleet: FleetConfig, reference: Reference) -> None:
    """What is too fast cannot be flown, or its flyers are not believed."""
    speed_m_s, acceleration_m_s2 = largest_pace(reference)
    believed_m_s, most_m_s2 = most_pace(fleet)
    for_turning = ", less what slots need that turn" if fleet.slots_turn else ""
    if acceleration_m_s2 > most_m_s2 * ROUNDED:
        field, asks, advice = _slower(
            reference, "max_acceleration_m_s2", most_m_s2, (acceleration_m_s2 / most_m_s2) ** 0.5
        )
        given = f"envelope.max_tilt_deg {fleet.envelope.max_tilt_deg:g} gives {most_m_s2:.1f}{for_turning}"
        raise ConfigError(
            file, f"{section}.{field}", f"{asks} for {acceleration_m_s2:.1f} m/s^2, {given}; expected {advice}"
        )
    if speed_m_s > believed_m_s * ROUNDED:
        field, asks, advice = _slower(reference, "max_speed_m_s", believed_m_s, speed_m_s / believed_m_s)
        given = f"peers.max_speed_m_s believes {believed_m_s:g}{for_turning}"
        raise ConfigError(file, f"{section}.{field}", f"{asks} for {speed_m_s:.1f} m/s, {given}; expected {advice}")


def _check_turns(
    file: Path, section: str, fleet: FleetConfig, reference: Lapping, slots_enu_m: Mapping[int, Vector3]
) -> None:
    """A formation that cannot follow the course would lag behind ever more."""
    outermost_m = reach_m(slots_enu_m.values())
    most_rad_s = turn_limits(outermost_m, fleet.slot_speed_m_s).rate_rad_s
    curve, period_s = reference.curve(), reference.period_s
    laps = (curve(reference.ramp_s + period_s * index / LAP_SAMPLES) for index in range(LAP_SAMPLES))
    turns = (course(velocity, acceleration, 0.0) for _, velocity, acceleration in laps)
    fastest_rad_s = max(abs(turn.rate_rad_s) for turn in turns if turn)
    if fastest_rad_s > most_rad_s * ROUNDED:
        longer_s = period_s * fastest_rad_s / most_rad_s + 0.05
        raise ConfigError(
            file,
            f"{section}.period_s",
            f"{period_s:g} s turns the course by up to {fastest_rad_s:.2f} rad/s; a formation that turns with it and reaches"
            f" {outermost_m:.1f} m can {most_rad_s:.2f}; expected at least {longer_s:.1f} s, or a larger slot_speed_m_s",
        )


def _slower(reference: Reference, limit: str, most: float, times: float) -> tuple[str, str, str]:
    """(field, what asks for too much, what would do), for a pace that is so many times too fast."""
    if isinstance(reference, Lapping):
        period_s, ramp_s = reference.period_s, reference.ramp_s
        return (
            "period_s",
            f"{period_s:g} s with ramp_s {ramp_s:g} asks",
            f"at least {period_s * times + 0.05:.1f} s with ramp_s {ramp_s * times + 0.05:.1f}, or a smaller figure",
        )
    return limit, f"{getattr(reference, limit):g} asks", f"at most {floor(most * 100.0) / 100.0:g}"


def _largest_pace_of_legs(reference: WaypointsReference) -> tuple[float, float]:
    legs_m = [leg_m for a, b in pairwise(reference.points_enu_m) if (leg_m := dist(a, b)) > 0.0]
    limits = (reference.max_speed_m_s, reference.max_acceleration_m_s2)
    legs = [(leg_m, duration_s(leg_m, *limits)) for leg_m in legs_m]
    return (
        max((PEAK_SPEED * leg_m / lasts_s for leg_m, lasts_s in legs), default=0.0),
        max((PEAK_ACCELERATION * leg_m / lasts_s**2 for leg_m, lasts_s in legs), default=0.0),
    )


def _ramp_and_lap_s(reference: Lapping) -> Iterator[float]:
    """While it gets up to its pace, and on the first full lap: later ones are the same."""
    for index in range(RAMP_SAMPLES):
        yield reference.ramp_s * index / RAMP_SAMPLES
    for index in range(LAP_SAMPLES):
        yield reference.ramp_s + reference.period_s * index / LAP_SAMPLES


def _box_about(centre_m: Vector3, a_m: float, b_m: float) -> tuple[Vector3, Vector3]:
    x, y, z = centre_m
    return (x - a_m, y - b_m, z), (x + a_m, y + b_m, z)
