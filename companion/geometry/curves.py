"""Curves of the RFT: position, velocity and acceleration over time, which begin at rest; and the braking law."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from math import cos, dist, floor, hypot, inf, log, pi, sin, sqrt

from companion.types.values import ZERO3, Vector3

Motion = tuple[Vector3, Vector3, Vector3]
"""Position [m], velocity [m/s], acceleration [m/s^2]."""
Curve = Callable[[float], Motion]
"""Motion at a time [s] since the start of the curve; before it, rest at the first point."""

PEAK_SPEED = 1.875  # largest speed of `rest_to_rest`, in path lengths per duration
PEAK_ACCELERATION = 10.0 / sqrt(3.0)  # likewise, in path lengths per duration squared
SHORTEST_LEG_M = 1e-6  # a shorter one takes no time
MANY_LEGS, DURATION_STEP = 32, 1.06


@dataclass(frozen=True, slots=True)
class Harmonic:
    """A periodic part of the reference: each axis moves by its amplitude [m] at this rate.

    `rotates`: in all horizontal directions in turn, or in one that is not known.
    """

    rate_rad_s: float
    amplitude_enu_m: Vector3
    rotates: bool = False

    def slowed(self, times: float) -> Harmonic:
        return Harmonic(self.rate_rad_s / times, self.amplitude_enu_m, self.rotates)

    @property
    def size_m(self) -> float:
        x, y, z = self.amplitude_enu_m
        return max(hypot(x, z), hypot(y, z)) if self.rotates else hypot(x, y, z)

    @classmethod
    def of_pace(
        cls, speed_m_s: float, acceleration_m_s2: float, direction_enu: Vector3, rotates: bool = False
    ) -> Harmonic:
        """The one with this largest speed and acceleration."""
        size_m = speed_m_s**2 / acceleration_m_s2
        x, y, z = direction_enu
        return cls(acceleration_m_s2 / speed_m_s, (x * size_m, y * size_m, z * size_m), rotates)


def figure_8(time_s: float, width_m: float, height_m: float, period_s: float, ramp_s: float) -> Motion:
    """A Lissajous curve about its centre: x = w/2 sin p, y = h/2 sin 2p.

    The rate p' rises from 0 to 2 pi / period over `ramp_s` as 3 u^2 - 2 u^3, so that the
    acceleration also begins at zero and has no step. The curve begins at its centre, at rest. A lap
    at the full rate takes `period_s`.
    """
    p, rate, rate_change = _phase(time_s, 2.0 * pi / period_s, ramp_s)
    a, b = width_m / 2.0, height_m / 2.0
    x, y = a * sin(p), b * sin(2.0 * p)
    dx, dy = a * cos(p), 2.0 * b * cos(2.0 * p)  # along p
    return (
        (x, y, 0.0),
        (dx * rate, dy * rate, 0.0),
        (dx * rate_change - x * rate**2, dy * rate_change - 4.0 * y * rate**2, 0.0),
    )


def circle(time_s: float, radius_m: float, period_s: float, ramp_s: float) -> Motion:
    """Counterclockwise from the east, with the ramp of `figure_8`; clockwise for a negative period."""
    p, rate, rate_change = _phase(time_s, 2.0 * pi / period_s, ramp_s)
    x, y = radius_m * cos(p), radius_m * sin(p)
    return (
        (x, y, 0.0),
        (-y * rate, x * rate, 0.0),
        (-y * rate_change - x * rate**2, x * rate_change - y * rate**2, 0.0),
    )


def centred_at(centre: Vector3, curve: Curve) -> Curve:
    """The curve translated by `centre`."""
    cx, cy, cz = centre

    def at(time_s: float) -> Motion:
        (x, y, z), velocity, acceleration = curve(time_s)
        return (cx + x, cy + y, cz + z), velocity, acceleration

    return at


def ramped(curve: Curve, lasts_s: float, ramp_s: float) -> Curve:
    """The curve from 0 to `lasts_s` with a ramp of its rate at both ends, as that of `figure_8`: it takes `ramp_s` longer."""
    whole_s = lasts_s + ramp_s

    def at(time_s: float) -> Motion:
        since_s, rate, change = _phase(min(time_s, whole_s - time_s), 1.0, ramp_s)
        if time_s > whole_s / 2.0:
            since_s, change = lasts_s - since_s, -change
        position, (vx, vy, vz), (ax, ay, az) = curve(since_s)
        return (
            position,
            (vx * rate, vy * rate, vz * rate),
            (ax * rate**2 + vx * change, ay * rate**2 + vy * change, az * rate**2 + vz * change),
        )

    return at


def decay_to_rest(begin: Motion, lasts_s: float) -> Curve:
    """Quintic from this position, velocity and acceleration to rest at the origin within `lasts_s`."""
    axes = [_quintic(p, v * lasts_s, a * lasts_s**2) for p, v, a in zip(*begin, strict=True)]

    def at(time_s: float) -> Motion:
        if time_s >= lasts_s:
            return ZERO3, ZERO3, ZERO3
        u = max(time_s, 0.0) / lasts_s
        (x, dx, ddx), (y, dy, ddy), (z, dz, ddz) = [polynomial(axis, u) for axis in axes]
        rate, rate2 = 1.0 / lasts_s, 1.0 / lasts_s**2
        return (x, y, z), (dx * rate, dy * rate, dz * rate), (ddx * rate2, ddy * rate2, ddz * rate2)

    return at


def waypoint_path(
    points_m: Sequence[Vector3], wait_s: float, max_speed_m_s: float, max_acceleration_m_s2: float
) -> Curve:
    """Straight legs within both limits, with a stop of `wait_s` at each point; rest at the last."""
    legs = list(pairwise(points_m))
    lasts_s = [duration_s(dist(a, b), max_speed_m_s, max_acceleration_m_s2) for a, b in legs]
    ends_s = list(accumulate(leg_s + wait_s for leg_s in lasts_s))

    def at(time_s: float) -> Motion:
        index = bisect_right(ends_s, time_s)
        if index >= len(legs):
            return points_m[-1], ZERO3, ZERO3
        since_s = time_s - (ends_s[index] - lasts_s[index] - wait_s)
        return rest_to_rest(*legs[index], since_s, lasts_s[index])

    return at


def duration_s(way_m: float, max_speed_m_s: float, max_acceleration_m_s2: float) -> float:
    """Shortest duration of `rest_to_rest` over this distance within both limits, s."""
    return max(PEAK_SPEED * way_m / max_speed_m_s, sqrt(PEAK_ACCELERATION * way_m / max_acceleration_m_s2))


def rest_to_rest(before: Vector3, after: Vector3, elapsed_s: float, lasts_s: float) -> Motion:
    """Straight minimum-jerk motion, 10 u^3 - 15 u^4 + 6 u^5; at rest before and afterwards."""
    if elapsed_s <= 0.0:
        return before, ZERO3, ZERO3
    if elapsed_s >= lasts_s:
        return after, ZERO3, ZERO3
    u = elapsed_s / lasts_s
    share = u * u * u * (10.0 + u * (6.0 * u - 15.0))
    rate = 30.0 * u * u * (1.0 - u) ** 2 / lasts_s
    rate_change = 60.0 * u * (1.0 - u) * (1.0 - 2.0 * u) / lasts_s**2
    (x, y, z), (ax, ay, az) = before, after
    dx, dy, dz = ax - x, ay - y, az - z
    return (
        (x + share * dx, y + share * dy, z + share * dz),
        (rate * dx, rate * dy, rate * dz),
        (rate_change * dx, rate_change * dy, rate_change * dz),
    )


def moving_legs(points_m: Sequence[Vector3]) -> list[tuple[Vector3, Vector3, float]]:
    """Start, end and length of each leg that takes time."""
    return [(a, b, leg_m) for a, b in pairwise(points_m) if (leg_m := dist(a, b)) > SHORTEST_LEG_M]


def peak_pace(way_m: float, lasts_s: float) -> tuple[float, float]:
    """Largest speed [m/s] and acceleration [m/s^2] of `rest_to_rest`."""
    return PEAK_SPEED * way_m / lasts_s, PEAK_ACCELERATION * way_m / lasts_s**2


def leg_harmonics(points_m: Sequence[Vector3], limits: tuple[float, float], slots_turn: bool) -> Iterator[Harmonic]:
    """One for each leg of a `waypoint_path` with another direction or pace, with its largest speed and acceleration.

    `limits`: of speed [m/s] and acceleration [m/s^2]. Of many legs the duration is shortened by up to DURATION_STEP, so that
    few rates remain: each is expensive.
    """
    legs = moving_legs(points_m)
    shortest_s = min((duration_s(leg_m, *limits) for *_, leg_m in legs), default=0.0)
    seen = set()
    for a, b, leg_m in legs:
        lasts_s = duration_s(leg_m, *limits)
        if lasts_s <= 0.0:
            continue
        if len(legs) > MANY_LEGS:
            lasts_s = shortest_s * DURATION_STEP ** floor(log(lasts_s / shortest_s) / log(DURATION_STEP) + 1e-9)
        direction = ((b[0] - a[0]) / leg_m, (b[1] - a[1]) / leg_m, (b[2] - a[2]) / leg_m)
        key = (round(leg_m, 3), *(round(abs(c), 3) for c in direction))
        if key in seen:
            continue
        seen.add(key)
        level = hypot(direction[0], direction[1])
        along = (level, level, abs(direction[2])) if slots_turn else direction
        yield Harmonic.of_pace(*peak_pace(leg_m, lasts_s), along, slots_turn)


def approach_speed(
    distance_m: float, deceleration_m_s2: float, slope_1_s: float, fastest_leaving_m_s: float = inf
) -> tuple[float, float]:
    """(speed m/s, its derivative by the distance 1/s) at which something may be approached that must not be passed.

    sqrt(2 a s) far away, and proportional to the distance near it: the square root alone has an infinite slope at distance 0,
    which no vehicle can follow. The straight line touches it at a/k^2, as in ArduPilot's `sqrt_controller`. Negative for a
    negative distance: the speed to leave at, of at most `fastest_leaving_m_s`.
    """
    straight_m = deceleration_m_s2 / (slope_1_s * slope_1_s)
    if distance_m > straight_m:
        speed_m_s = sqrt(2.0 * deceleration_m_s2 * (distance_m - 0.5 * straight_m))
        return speed_m_s, deceleration_m_s2 / speed_m_s
    speed_m_s = slope_1_s * distance_m
    return (speed_m_s, slope_1_s) if speed_m_s >= -fastest_leaving_m_s else (-fastest_leaving_m_s, 0.0)


Coefficients = tuple[float, float, float, float, float, float]


def _quintic(p: float, v: float, a: float) -> Coefficients:
    """Coefficients of 1, u, ..., u^5: p, v and a at u = 0, position, velocity and acceleration 0 at u = 1."""
    return (
        p,
        v,
        a / 2.0,
        -10.0 * p - 6.0 * v - 1.5 * a,
        15.0 * p + 8.0 * v + 1.5 * a,
        -6.0 * p - 3.0 * v - 0.5 * a,
    )


def polynomial(coefficients: Coefficients, u: float) -> Vector3:
    """Value, first and second derivative at u."""
    c0, c1, c2, c3, c4, c5 = coefficients
    return (
        c0 + u * (c1 + u * (c2 + u * (c3 + u * (c4 + u * c5)))),
        c1 + u * (2.0 * c2 + u * (3.0 * c3 + u * (4.0 * c4 + u * 5.0 * c5))),
        2.0 * c2 + u * (6.0 * c3 + u * (12.0 * c4 + u * 20.0 * c5)),
    )


def _phase(time_s: float, full_rate_rad_s: float, ramp_s: float) -> tuple[float, float, float]:
    """Phase p, p' and p'' of a curve with a ramp of its rate."""
    u = time_s / ramp_s
    if u <= 0.0:
        return 0.0, 0.0, 0.0
    if u >= 1.0:
        return full_rate_rad_s * (time_s - ramp_s / 2.0), full_rate_rad_s, 0.0
    return (
        full_rate_rad_s * ramp_s * (u**3 - u**4 / 2.0),
        full_rate_rad_s * (3.0 * u**2 - 2.0 * u**3),
        full_rate_rad_s * 6.0 * (u - u**2) / ramp_s,
    )
