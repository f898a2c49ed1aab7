"""An RFT that follows a target which nobody knows beforehand: within its limits of speed, acceleration and fence, always.

Velocity follows the target's velocity and a pull towards its place, with 1/(4 SETTLE_S) of pull: critically damped, and without
lag behind what moves steadily. Its acceleration changes no faster than JERK allows, so that no attitude steps.

The limits hold whatever the target does. A velocity that is drawn towards one inside the ball of the largest speed stays in the
ball. A step after which the fence could not be kept any more, by braking with what each of three axes has for sure, is replaced
by such braking; the step before left room for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, sqrt

from companion.core.formation import Place
from companion.types import Vector3

Box = tuple[Vector3, Vector3]
"""Lowest and highest coordinates."""

SETTLE_S = 0.4
PULL_1_S = 1.0 / (4.0 * SETTLE_S)
JERK_1_S = 4.0  # of the largest acceleration, a second
APPROACH = 0.5  # of the largest acceleration: what it means to brake with near its place
STEP_S = 0.05
LONGEST_S = 0.5  # of a pause; after a longer one it goes on from where it was


@dataclass(frozen=True, slots=True)
class PursuitLimits:
    speed_m_s: float
    acceleration_m_s2: float

    @property
    def axis_acceleration_m_s2(self) -> float:
        """What each axis can have whatever the others need."""
        return self.acceleration_m_s2 / sqrt(3.0)


class Pursuit:
    """`place` is R and r''. It begins with any place and velocity from which its limits can be kept."""

    def __init__(self, limits: PursuitLimits, begin: Place) -> None:
        self._limits = limits
        self.place = begin

    def advance(self, seconds: float, goal_enu_m: Vector3 | None, velocity_enu_m_s: Vector3, box: Box) -> None:
        """Let this time pass towards a goal that moves so; without a goal the velocity alone is followed."""
        seconds = min(seconds, LONGEST_S)
        if seconds <= 0.0:
            return
        steps = ceil(seconds / STEP_S)
        if goal_enu_m is not None:
            goal_enu_m, velocity_enu_m_s = _inside(goal_enu_m, velocity_enu_m_s, box)
        for _ in range(steps):
            self.place = _step(self.place, self._limits, goal_enu_m, velocity_enu_m_s, box, seconds / steps)


def can_keep(place: Place, limits: PursuitLimits, box: Box) -> bool:
    """Can a pursuit begin here and keep speed and fence?"""
    slow = hypot(*place.velocity_enu_m_s) <= limits.speed_m_s
    return slow and _can_stop(place.position_enu_m, place.velocity_enu_m_s, limits, box)


def _step(
    place: Place, limits: PursuitLimits, goal_enu_m: Vector3 | None, velocity_enu_m_s: Vector3, box: Box, dt_s: float
) -> Place:
    before, v = place.position_enu_m, place.velocity_enu_m_s
    wanted = _wanted_velocity(before, goal_enu_m, velocity_enu_m_s, limits, box)
    acceleration = _shortened(_scaled(_minus(wanted, v), 1.0 / SETTLE_S), limits.acceleration_m_s2)
    last = _shortened(place.acceleration_enu_m_s2, limits.acceleration_m_s2)
    change = _shortened(_minus(acceleration, last), JERK_1_S * limits.acceleration_m_s2 * dt_s)
    after = _shortened(_plus(v, _scaled(_plus(last, change), dt_s)), limits.speed_m_s)
    if not _can_stop(_moved(before, v, after, dt_s), after, limits, box):
        slower = limits.axis_acceleration_m_s2 * dt_s
        x, y, z = (_towards_zero(c, slower) for c in v)
        after = (x, y, z)
    return Place(_moved(before, v, after, dt_s), after, _scaled(_minus(after, v), 1.0 / dt_s))


def _wanted_velocity(
    position: Vector3, goal: Vector3 | None, velocity: Vector3, limits: PursuitLimits, box: Box
) -> Vector3:
    wanted = velocity
    if goal is not None and (way_m := hypot(*(way := _minus(goal, position)))) > 0.0:
        speed = _approach_m_s(way_m, APPROACH * limits.acceleration_m_s2)
        wanted = _plus(velocity, _scaled(way, speed / way_m))
    braking = APPROACH * limits.axis_acceleration_m_s2
    x, y, z = (
        min(max(v, -_approach_m_s(p - low, braking)), _approach_m_s(high - p, braking))
        for v, p, low, high in zip(_shortened(wanted, limits.speed_m_s), position, *box, strict=True)
    )
    return (x, y, z)


def _approach_m_s(way_m: float, braking_m_s2: float) -> float:
    """How fast it may come nearer, so far from where it is to stop."""
    straight_m = braking_m_s2 / PULL_1_S**2  # nearer, the pull alone asks for less than that braking
    if way_m < straight_m:
        return PULL_1_S * max(way_m, 0.0)
    return sqrt(braking_m_s2 * (2.0 * way_m - straight_m))


def _can_stop(position: Vector3, velocity: Vector3, limits: PursuitLimits, box: Box) -> bool:
    """Before the fence, on each axis; half a step is added, for a step in which it stops is not all braking."""
    a = limits.axis_acceleration_m_s2
    for p, v, low, high in zip(position, velocity, *box, strict=True):
        room = high - p if v > 0.0 else p - low
        if v != 0.0 and room < v * v / (2.0 * a) + abs(v) * STEP_S / 2.0:
            return False
    return True


def _inside(goal: Vector3, velocity: Vector3, box: Box) -> tuple[Vector3, Vector3]:
    """The nearest place in the box, which does not move out of it."""
    places, rates = [], []
    for p, v, low, high in zip(goal, velocity, *box, strict=True):
        outside = (p >= high and v > 0.0) or (p <= low and v < 0.0)
        places.append(min(max(p, low), high))
        rates.append(0.0 if outside else v)
    (x, y, z), (vx, vy, vz) = places, rates
    return (x, y, z), (vx, vy, vz)


def _moved(position: Vector3, v: Vector3, after: Vector3, dt_s: float) -> Vector3:
    return _plus(position, _scaled(_plus(v, after), dt_s / 2.0))


def _towards_zero(value: float, by: float) -> float:
    return max(value - by, 0.0) if value > 0.0 else min(value + by, 0.0)


def _shortened(vector: Vector3, longest: float) -> Vector3:
    length = hypot(*vector)
    return vector if length <= longest else _scaled(vector, longest / length)


def _scaled(vector: Vector3, by: float) -> Vector3:
    x, y, z = vector
    return (x * by, y * by, z * by)


def _plus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def _minus(a: Vector3, b: Vector3) -> Vector3:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])
