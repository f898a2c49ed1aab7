"""RFT that follows a target whose motion is not known in advance, within limits of speed, acceleration and fence.

The velocity follows the target's velocity plus a pull towards its position (see `approach`): critically damped, and without
lag behind a target of constant velocity. The acceleration changes at a limited rate, so that attitude setpoints do not step.

The limits hold for any motion of the target. A velocity drawn towards another inside the ball of the largest speed stays in
that ball. A step after which the fence could no longer be kept by braking on each axis is replaced by such braking; the
step before left room for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot, sqrt

from companion.core.consensus.law import FormationState
from companion.core.reference.approach import APPROACH, JERK_1_S, LONGEST_S, SETTLE_S, approach_speed
from companion.geometry.vectors import minus, plus, scaled, shortened
from companion.types.vectors import Vector3

Box = tuple[Vector3, Vector3]
"""Lowest and highest coordinates, m."""

STEP_S = 0.05


@dataclass(frozen=True, slots=True)
class TargetLimits:
    """Largest speed and acceleration of the RFT."""

    speed_m_s: float
    acceleration_m_s2: float

    @property
    def axis_acceleration_m_s2(self) -> float:
        """Acceleration that each axis can have at the same time."""
        return self.acceleration_m_s2 / sqrt(3.0)


class TargetPursuit:
    """RFT state R and r'', advanced towards a moving goal. The initial state must satisfy `can_keep`."""

    def __init__(self, limits: TargetLimits, begin: FormationState) -> None:
        self._limits = limits
        self.state = begin

    def advance(self, seconds: float, goal_enu_m: Vector3 | None, velocity_enu_m_s: Vector3, box: Box) -> None:
        """Advance by this time towards a goal of this velocity. Without a goal only the velocity is followed."""
        seconds = min(seconds, LONGEST_S)
        if seconds <= 0.0:
            return
        steps = ceil(seconds / STEP_S)
        if goal_enu_m is not None:
            goal_enu_m, velocity_enu_m_s = _inside(goal_enu_m, velocity_enu_m_s, box)
        for _ in range(steps):
            self.state = _step(self.state, self._limits, goal_enu_m, velocity_enu_m_s, box, seconds / steps)


def can_keep(state: FormationState, limits: TargetLimits, box: Box) -> bool:
    """Whether a pursuit that begins in this state can keep speed and fence."""
    slow = hypot(*state.velocity_enu_m_s) <= limits.speed_m_s
    return slow and _can_stop(state.position_enu_m, state.velocity_enu_m_s, limits, box)


def _step(
    state: FormationState,
    limits: TargetLimits,
    goal_enu_m: Vector3 | None,
    velocity_enu_m_s: Vector3,
    box: Box,
    dt_s: float,
) -> FormationState:
    before, v = state.position_enu_m, state.velocity_enu_m_s
    wanted = _wanted_velocity(before, goal_enu_m, velocity_enu_m_s, limits, box)
    acceleration = shortened(scaled(minus(wanted, v), 1.0 / SETTLE_S), limits.acceleration_m_s2)
    last = shortened(state.acceleration_enu_m_s2, limits.acceleration_m_s2)
    change = shortened(minus(acceleration, last), JERK_1_S * limits.acceleration_m_s2 * dt_s)
    after = shortened(plus(v, scaled(plus(last, change), dt_s)), limits.speed_m_s)
    if not _can_stop(_moved(before, v, after, dt_s), after, limits, box):
        slower = limits.axis_acceleration_m_s2 * dt_s
        x, y, z = (_towards_zero(c, slower) for c in v)
        after = (x, y, z)
    return FormationState(_moved(before, v, after, dt_s), after, scaled(minus(after, v), 1.0 / dt_s))


def _wanted_velocity(
    position: Vector3, goal: Vector3 | None, velocity: Vector3, limits: TargetLimits, box: Box
) -> Vector3:
    wanted = velocity
    if goal is not None and (distance_m := hypot(*(offset := minus(goal, position)))) > 0.0:
        speed_m_s = approach_speed(distance_m, APPROACH * limits.acceleration_m_s2)
        wanted = plus(velocity, scaled(offset, speed_m_s / distance_m))
    braking = APPROACH * limits.axis_acceleration_m_s2
    x, y, z = (
        min(max(v, -approach_speed(p - low, braking)), approach_speed(high - p, braking))
        for v, p, low, high in zip(shortened(wanted, limits.speed_m_s), position, *box, strict=True)
    )
    return (x, y, z)


def _can_stop(position: Vector3, velocity: Vector3, limits: TargetLimits, box: Box) -> bool:
    """Whether braking stops before the fence on each axis. Half a step is added: the step that stops does not only brake."""
    a = limits.axis_acceleration_m_s2
    for p, v, low, high in zip(position, velocity, *box, strict=True):
        room = high - p if v > 0.0 else p - low
        if v != 0.0 and room < v * v / (2.0 * a) + abs(v) * STEP_S / 2.0:
            return False
    return True


def _inside(goal: Vector3, velocity: Vector3, box: Box) -> tuple[Vector3, Vector3]:
    """The nearest position in the box, and the velocity without the part that leaves the box."""
    positions, rates = [], []
    for p, v, low, high in zip(goal, velocity, *box, strict=True):
        outside = (p >= high and v > 0.0) or (p <= low and v < 0.0)
        positions.append(min(max(p, low), high))
        rates.append(0.0 if outside else v)
    (x, y, z), (vx, vy, vz) = positions, rates
    return (x, y, z), (vx, vy, vz)


def _moved(position: Vector3, v: Vector3, after: Vector3, dt_s: float) -> Vector3:
    return plus(position, scaled(plus(v, after), dt_s / 2.0))


def _towards_zero(value: float, by: float) -> float:
    return max(value - by, 0.0) if value > 0.0 else min(value + by, 0.0)
