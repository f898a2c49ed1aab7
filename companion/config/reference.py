"""The `reference` (RFT) of a vehicle file, a scenario or a command: its kinds, and all that a kind says of itself.

A kind is one class: its keys with their bounds, where it leads, how fast it is, and what slows it down. ASKED has the option
of `companion fleet reference` and the input of the page for each key. So a new kind is one more class here and in `Reference`;
one whose trajectory is not known beforehand, like that of a target, also has an RFT of its own in `core/reference`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import ceil, dist, floor, hypot, tau
from pathlib import Path
from typing import Annotated, ClassVar, Self, get_args, get_origin, get_type_hints

from msgspec import Meta
from msgspec.structs import replace

from companion.config.file import convert, read_as
from companion.config.values import Name, PositionM, Section, about
from companion.geometry.curves import (
    Curve,
    Harmonic,
    centred_at,
    circle,
    duration_s,
    figure_8,
    leg_harmonics,
    moving_legs,
    peak_pace,
    waypoint_path,
)
from companion.types.values import ZERO3, Vector3

RAMP_SAMPLES, LAP_SAMPLES = 100, 500
TARGET_RATES = (
    0.1,
    0.3,
    1.0,
    2.0,
    4.0,
)  # frequencies of a target's motion to check, times largest acceleration over speed


Speed = Annotated[float, about("largest speed", ge=0.01, le=100)]
Size = Annotated[float, Meta(ge=0.01, le=1000)]


@dataclass(frozen=True, slots=True)
class Asked:
    """How an operator is asked for a key: by an option of `companion fleet reference`, and with a `title` on the page.

    The page begins with `initial`, without one with the default of the key.
    """

    option: str
    meaning: str
    title: str = ""
    initial: float | str | None = None


ASKED = {
    "radius_m": Asked("--radius", "of a circle, metres", "Radius", 6.0),
    "width_m": Asked("--width", "of a whole figure 8, along x, metres", "Width, east", 16.0),
    "height_m": Asked("--height", "of a whole figure 8, along y, metres", "Height, north", 8.0),
    "period_s": Asked("--period", "of one lap of a circle or figure 8, seconds", "Period", 40.0),
    "ramp_s": Asked("--ramp", "until a circle or figure 8 reaches its speed, seconds"),
    "max_speed_m_s": Asked("--speed", "limit for waypoints or a target, m/s", "Speed"),
    "wait_s": Asked("--pause", "at each waypoint, seconds", "Stop at each"),
    "max_acceleration_m_s2": Asked("--acceleration", "limit for waypoints or a target, m/s^2"),
    "clockwise": Asked("--clockwise", "a circle, seen from above", "clockwise"),
    "name": Asked("--name", "of the target (default main)", "Target"),
    "offset_enu_m": Asked("--offset", "from the target to the reference, metres"),
    "follows_altitude": Asked("--follows-altitude", "follow the altitude of the target as well"),
}


class BaseReference(Section, frozen=True):
    """What every kind answers. What a kind does not say itself is that of a point at rest."""

    TITLE: ClassVar[str]  # on the page
    POSITION: ClassVar[str]  # the key that --at and the map fill
    PLACE: ClassVar[str] = "point"  # what that position is
    MOST_POSITIONS: ClassVar[int] = 1
    AWAITED: ClassVar[bool] = False  # whether the fleet may wait for it where it is
    MOVES: ClassVar[bool] = True

    @property
    def kind(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def start_enu_m(self) -> Vector3:
        position: Vector3 = getattr(self, self.POSITION)
        return position

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        """Lowest and highest corner of the box that contains the curve."""
        return self.start_enu_m, self.start_enu_m

    def curve(self) -> Curve:
        """Where it leads; of a kind that is not known beforehand, the curve before it is known."""
        return lambda _time_s: (self.start_enu_m, ZERO3, ZERO3)

    def legs_enu_m(self) -> Sequence[tuple[Vector3, Vector3]]:
        """The straight lines that it flies one after the other; none of a curve."""
        return ()

    def largest_pace(self) -> tuple[float, float]:
        """Largest speed [m/s] and acceleration [m/s^2] at any time, or its limits."""
        return 0.0, 0.0

    def whole_s(self) -> float | None:
        """Time that shows the whole of it, seconds; None where it has no end."""
        return None

    def curve_s(self) -> float:
        """Time along `curve` after which it repeats itself, or is at rest, seconds."""
        return 0.0

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """What the law has to follow, each motion by itself, its harmonics at the same time; none of a reference at rest.

        The slots of a formation that turns point in all directions in turn.
        """
        del slots_turn
        return []

    def excess(self, limit: str, most: float, times: float) -> tuple[str, str, str]:
        """(key, what asks for too much, advice) where it is this many times too fast for `most` of a limit."""
        raise NotImplementedError

    def slower_pace(self, times: float) -> tuple[str, str, str]:
        """(key, its value, advice) where it must take this many times longer."""
        raise NotImplementedError

    def slow_down(self, times: float) -> Self:
        """The same with a pace that takes this many times longer, in rounded values."""
        del times
        return self


class LappingReference(BaseReference, frozen=True, kw_only=True):
    """One that laps.

    period_s: time of a lap at full pace
    ramp_s: time from rest to full pace
    """

    LAP_SAMPLES: ClassVar[int]  # so many of the LAP_SAMPLES points of a lap differ in pace or turn
    PLACE = "centre"

    period_s: Annotated[float, Meta(ge=1, le=3600)]
    ramp_s: Annotated[float, Meta(ge=0.1, le=60)] = 5.0

    def lap_s(self) -> list[float]:
        """Times of a lap at full pace, as far as pace and turns differ."""
        return [self.ramp_s + self.period_s * index / LAP_SAMPLES for index in range(self.LAP_SAMPLES)]

    def largest_pace(self) -> tuple[float, float]:
        return _pace_of_laps(self)

    def whole_s(self) -> float:
        """A lap, and the time to get up to its speed and back."""
        return float(ceil(self.period_s + 2.0 * self.ramp_s))

    def curve_s(self) -> float:
        return self.ramp_s + self.period_s

    def excess(self, limit: str, most: float, times: float) -> tuple[str, str, str]:
        del limit, most
        return (
            "period_s",
            f"{self.period_s:g} s with ramp_s {self.ramp_s:g} asks",
            f"at least {self.period_s * times + 0.05:.1f} s with ramp_s {self.ramp_s * times + 0.05:.1f},"
            " or a smaller figure",
        )

    def slower_pace(self, times: float) -> tuple[str, str, str]:
        period_s, ramp_s = (ceil(seconds * times * 10.0) / 10.0 for seconds in (self.period_s, self.ramp_s))
        return "period_s", f"{self.period_s:g} s", f"at least {period_s:g} s with ramp_s {ramp_s:g}"

    def slow_down(self, times: float) -> Self:
        return replace(self, period_s=float(ceil(self.period_s * times)))


@lru_cache(maxsize=8)  # several checks of a reference need it
def _pace_of_laps(reference: LappingReference) -> tuple[float, float]:
    curve = reference.curve()
    ramp_s = [reference.ramp_s * index / RAMP_SAMPLES for index in range(RAMP_SAMPLES)]
    motions = [curve(time_s) for time_s in ramp_s + reference.lap_s()]
    return max(hypot(*m[1]) for m in motions), max(hypot(*m[2]) for m in motions)


class LimitedReference(BaseReference, frozen=True, kw_only=True):
    """One within limits; the kind declares its `max_speed_m_s`.

    max_acceleration_m_s2: largest acceleration
    """

    max_acceleration_m_s2: Annotated[float, Meta(ge=0.01, le=50)] = 1.0

    @property
    def max_speed_m_s(self) -> float:
        raise NotImplementedError

    @property
    def limits(self) -> tuple[float, float]:
        return self.max_speed_m_s, self.max_acceleration_m_s2

    def largest_pace(self) -> tuple[float, float]:
        return self.limits

    def excess(self, limit: str, most: float, times: float) -> tuple[str, str, str]:
        del times
        return limit, f"{getattr(self, limit):g} asks", f"at most {floor(most * 100.0) / 100.0:g}"

    def slower_pace(self, times: float) -> tuple[str, str, str]:
        speed_m_s = floor(self.max_speed_m_s / times * 1000.0) / 1000.0
        acceleration_m_s2 = floor(self.max_acceleration_m_s2 / times**2 * 1000.0) / 1000.0
        advice = f"at most {acceleration_m_s2:g} m/s^2 with max_speed_m_s {speed_m_s:g}"
        return "max_acceleration_m_s2", f"{self.max_acceleration_m_s2:g} m/s^2", advice

    def slow_down(self, times: float) -> Self:
        return replace(
            self,
            max_speed_m_s=round(self.max_speed_m_s / times, 3),
            max_acceleration_m_s2=round(self.max_acceleration_m_s2 / times**2, 3),
        )


class PointReference(BaseReference, frozen=True, tag_field="kind", tag="point"):
    """A fixed point: r = point, r' = 0.

    point_enu_m: the point
    """

    TITLE, POSITION, MOVES = "Point", "point_enu_m", False

    point_enu_m: PositionM


class WaypointsReference(LimitedReference, frozen=True, tag_field="kind", tag="waypoints"):
    """Straight lines from point to point, with a stop at each. It starts at the first point and ends at the last.

    points_enu_m: the points in order
    wait_s: time of the stop at each point
    """

    TITLE, POSITION, MOST_POSITIONS = "Waypoints", "points_enu_m", 200

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


class CircleReference(LappingReference, frozen=True, tag_field="kind", tag="circle"):
    """A level circle, counterclockwise, from rest at its easternmost point.

    centre_enu_m: centre of the circle
    radius_m: radius
    clockwise: `true`: clockwise, seen from above
    """

    TITLE, POSITION, LAP_SAMPLES = "Circle", "centre_enu_m", 1

    centre_enu_m: PositionM
    radius_m: Size
    clockwise: bool = False

    @property
    def start_enu_m(self) -> Vector3:
        x, y, z = self.centre_enu_m
        return (x + self.radius_m, y, z)

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        return _box_about(self.centre_enu_m, self.radius_m, self.radius_m)

    def curve(self) -> Curve:
        period_s = -self.period_s if self.clockwise else self.period_s
        return centred_at(self.centre_enu_m, lambda time_s: circle(time_s, self.radius_m, period_s, self.ramp_s))

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        del slots_turn  # it points in all directions by itself
        lap = Harmonic(tau / self.period_s, (self.radius_m, self.radius_m, 0.0), rotates=True)
        return [[lap], [Harmonic.of_pace(*self.largest_pace(), (1.0, 1.0, 0.0), rotates=True)]]


class Figure8Reference(LappingReference, frozen=True, tag_field="kind", tag="figure_8"):
    """A level figure 8 along x, from rest at its centre.

    centre_enu_m: centre of the 8, where it starts
    width_m: size of the whole 8 along x
    height_m: size of the whole 8 along y
    """

    TITLE, POSITION, LAP_SAMPLES = "Figure 8", "centre_enu_m", LAP_SAMPLES // 2

    centre_enu_m: PositionM
    width_m: Size
    height_m: Size

    def corners_enu_m(self) -> tuple[Vector3, Vector3]:
        return _box_about(self.centre_enu_m, self.width_m / 2.0, self.height_m / 2.0)

    def curve(self) -> Curve:
        shape = (self.width_m, self.height_m, self.period_s, self.ramp_s)
        return centred_at(self.centre_enu_m, lambda time_s: figure_8(time_s, *shape))

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        rate_rad_s, a_m, b_m = tau / self.period_s, self.width_m / 2.0, self.height_m / 2.0
        if slots_turn:
            return [
                [
                    Harmonic(rate_rad_s, (a_m, a_m, 0.0), rotates=True),
                    Harmonic(2.0 * rate_rad_s, (b_m, b_m, 0.0), rotates=True),
                ]
            ]
        return [[Harmonic(rate_rad_s, (a_m, 0.0, 0.0)), Harmonic(2.0 * rate_rad_s, (0.0, b_m, 0.0))]]


class TargetReference(LimitedReference, frozen=True, tag_field="kind", tag="target"):
    """Follows a moving target, which publishes on formation/FLEET/target/NAME. It stays inside the fence by itself.

    start_enu_m: start, where it waits for the first message of the target
    name: name of the target, NAME of its key
    offset_enu_m: offset of the RFT from the target
    follows_altitude: `true`: z follows the target; `false`: z stays that of the start
    max_age_s: without a newer message for this time the RFT comes to rest
    """

    TITLE, POSITION, PLACE, AWAITED = "Follow a target", "start_enu_m", "start", True

    start_enu_m: PositionM
    name: Name = "main"
    offset_enu_m: PositionM = ZERO3
    follows_altitude: bool = False
    max_speed_m_s: Speed = 3.0
    max_age_s: Annotated[float, Meta(gt=0.05, le=10)] = 1.0

    def motions(self, slots_turn: bool) -> list[list[Harmonic]]:
        """It may move at any rate within its limits, in any direction."""
        del slots_turn
        up = 1.0 if self.follows_altitude else 0.0
        motions = []
        for share in TARGET_RATES:
            rate_rad_s = share * self.max_acceleration_m_s2 / self.max_speed_m_s
            most_m = min(self.max_speed_m_s / rate_rad_s, self.max_acceleration_m_s2 / rate_rad_s**2)
            motions.append([Harmonic(rate_rad_s, (most_m, most_m, up * most_m), rotates=True)])
        return motions


Reference = PointReference | WaypointsReference | CircleReference | Figure8Reference | TargetReference
KINDS: dict[str, type[BaseReference]] = {str(kind.__struct_config__.tag): kind for kind in get_args(Reference)}


class ReferenceSection(Section, frozen=True):
    """A file, command line or command with a reference and nothing else.

    reference: the trajectory of the formation (RFT)
    """

    reference: Reference


def load_reference(path: Path) -> Reference:
    """Read a file with a section `reference` and nothing else. Raises ConfigError."""
    return convert(path, read_as(path, "reference"), ReferenceSection).reference


def type_of_key(key: str) -> type:
    """float, bool, str or tuple of a key in ASKED."""
    kind = next(kind for kind in KINDS.values() if key in kind.__struct_fields__)
    plain: type = get_type_hints(kind)[key]
    return get_origin(plain) or plain


def _box_about(centre_m: Vector3, a_m: float, b_m: float) -> tuple[Vector3, Vector3]:
    x, y, z = centre_m
    return (x - a_m, y - b_m, z), (x + a_m, y + b_m, z)
