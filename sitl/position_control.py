"""The stand-in's own position control, for the modes that it flies by itself: hold, take-off, return, landing.

It flies on the estimate. A proportional and damped loop with an integrator, towards a target that moves at a limited speed.
"""

from __future__ import annotations

from math import dist, radians

from companion.core.attitude import attitude_target, limit_acceleration
from companion.frames import quaternion_from_euler
from companion.types import Vector3
from sitl.attitude_control import Setpoint

LEVEL_GAINS = (1.6, 2.2, 0.3)  # on position [1/s^2], velocity [1/s] and the integral of position [1/s^3]
CLIMB_GAINS = (4.0, 3.6, 0.6)
MAX_INTEGRAL_M_S2 = 3.0
MAX_TILT_RAD = radians(30.0)


class PositionControl:
    """Flies to `goal` at `level_speed_m_s` and `climb_speed_m_s`; both may be changed at any time."""

    def __init__(self, hover_thrust_norm: float) -> None:
        self._hover_thrust_norm = hover_thrust_norm
        self.start((0.0, 0.0, 0.0), 0.0)

    def start(self, position_m: Vector3, yaw_rad: float) -> None:
        """Hold here from now on."""
        self._target = position_m
        self._integral = [0.0, 0.0, 0.0]
        self.goal = position_m
        self.yaw_rad = yaw_rad
        self.level_speed_m_s = 3.0
        self.climb_speed_m_s = 1.5

    def arrived(self, position_m: Vector3, within_m: float) -> bool:
        return self._target == self.goal and dist(position_m, self.goal) < within_m

    def setpoint(self, position_m: Vector3, velocity_m_s: Vector3, euler_rad: Vector3, dt_s: float) -> Setpoint:
        """One step: move the target towards the goal and follow it."""
        target_velocity = self._move_target(dt_s)
        wanted = []
        for axis, (k1, k2, ki) in enumerate((LEVEL_GAINS, LEVEL_GAINS, CLIMB_GAINS)):
            error = self._target[axis] - position_m[axis]
            if self._target == self.goal:  # on the way it would only wind up
                integral = self._integral[axis] + ki * error * dt_s
                self._integral[axis] = max(-MAX_INTEGRAL_M_S2, min(MAX_INTEGRAL_M_S2, integral))
            wanted.append(k1 * error + k2 * (target_velocity[axis] - velocity_m_s[axis]) + self._integral[axis])
        acceleration = limit_acceleration((wanted[0], wanted[1], wanted[2]), MAX_TILT_RAD, 0.3, 1.7)
        roll, pitch, _ = euler_rad
        target = attitude_target(acceleration, self.yaw_rad, roll, pitch, self._hover_thrust_norm)
        quaternion = quaternion_from_euler(target.roll_rad, target.pitch_rad, target.yaw_rad)
        return Setpoint(quaternion, min(1.0, target.thrust_norm))

    def _move_target(self, dt_s: float) -> Vector3:
        """The target's velocity over this step."""
        steps = []
        for axis, speed in enumerate((self.level_speed_m_s, self.level_speed_m_s, self.climb_speed_m_s)):
            most = speed * dt_s
            steps.append(max(-most, min(most, self.goal[axis] - self._target[axis])))
        x, y, z = self._target
        self._target = (x + steps[0], y + steps[1], z + steps[2])
        return (steps[0] / dt_s, steps[1] / dt_s, steps[2] / dt_s)
