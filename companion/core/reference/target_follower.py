"""RFT that follows a target whose motion is not known in advance, within limits of speed, acceleration and room.

The velocity follows the target's velocity plus a pull towards its position (see `approach`): critically damped, and without
lag behind a target of constant velocity. The acceleration changes at a limited rate, so that attitude setpoints do not step.

The limits hold for any motion of the target. A velocity drawn towards another inside the ball of the largest speed stays in
that ball. A step after which the walls of the room could no longer be kept by braking is replaced by such braking; the
step before left room for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import ceil, hypot

from companion.core.consensus.law import FormationState
from companion.core.reference.approach import APPROACH, JERK_1_S, LONGEST_S, SETTLE_S, approach_speed
from companion.core.reference.room import STEP_S, Box, Room
from companion.geometry.vectors import minus, plus, scaled, shortened
from companion.types.values import Vector3


@dataclass(frozen=True, slots=True)
class TargetLimits:
    """Largest speed and acceleration of the RFT."""

    speed_m_s: float
    acceleration_m_s2: float


class TargetPursuit:
    """RFT state R and r'', advanced towards a moving goal. The initial state must satisfy `can_keep`."""

    def __init__(self, limits: TargetLimits, begin: FormationState) -> None:
        self._limits = limits
        self.state = begin

    def advance(self, seconds: float, goal_enu_m: Vector3 | None, velocity_enu_m_s: Vector3, room: Room) -> None:
        """Advance by this time towards a goal of this velocity. Without a goal only the velocity is followed."""
        seconds = min(seconds, LONGEST_S)
        if seconds <= 0.0:
            return
        steps = ceil(seconds / STEP_S)
        if goal_enu_m is not None:
            goal_enu_m, velocity_enu_m_s = _inside(goal_enu_m, velocity_enu_m_s, room.box)
        for _ in range(steps):
            self.state = _step(self.state, self._limits, goal_enu_m, velocity_enu_m_s, room, seconds / steps)


def can_keep(state: FormationState, limits: TargetLimits, room: Room) -> bool:
    """Whether a pursuit that begins in this state can keep speed and room."""
    slow = hypot(*state.velocity_enu_m_s) <= limits.speed_m_s
    return slow and room.can_stop(state.position_enu_m, state.velocity_enu_m_s, limits.acceleration_m_s2)


def _step(
    state: FormationState,
    limits: TargetLimits,
    goal_enu_m: Vector3 | None,
    velocity_enu_m_s: Vector3,
    room: Room,
    dt_s: float,
) -> FormationState:
    before, v = state.position_enu_m, state.velocity_enu_m_s
    wanted = shortened(_wanted_velocity(before, goal_enu_m, velocity_enu_m_s, limits), limits.speed_m_s)
    wanted = room.kept_away(wanted, before, v, limits.acceleration_m_s2)
    acceleration = shortened(scaled(minus(wanted, v), 1.0 / SETTLE_S), limits.acceleration_m_s2)
    last = shortened(state.acceleration_enu_m_s2, limits.acceleration_m_s2)
    change = shortened(minus(acceleration, last), JERK_1_S * limits.acceleration_m_s2 * dt_s)
    after = shortened(plus(v, scaled(plus(last, change), dt_s)), limits.speed_m_s)
    if not room.can_stop(_moved(before, v, after, dt_s), after, limits.acceleration_m_s2):
        after = shortened(v, max(0.0, hypot(*v) - limits.acceleration_m_s2 * dt_s))
    return FormationState(_moved(before, v, after, dt_s), after, scaled(minus(after, v), 1.0 / dt_s))


def _wanted_velocity(position: Vector3, goal: Vector3 | None, velocity: Vector3, limits: TargetLimits) -> Vector3:
    if goal is None or (distance_m := hypot(*(offset := minus(goal, position)))) == 0.0:
        return velocity
    speed_m_s = approach_speed(distance_m, APPROACH * limits.acceleration_m_s2)
    return plus(velocity, scaled(offset, speed_m_s / distance_m))


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
