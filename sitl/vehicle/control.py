"""The loops of a stand-in: attitude control, as fast as measured, and position control for its automatic modes.

Position control uses the estimate: a damped proportional loop with an integrator follows a target that moves with limited
speed and acceleration.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import copysign, inf, radians, sqrt

from msgspec import Struct

from companion.core.control.setpoint import attitude_target, limit_acceleration
from companion.geometry.frames import Quaternion, quaternion_from_euler
from companion.geometry.vectors import clamped
from companion.types.values import Vector3

LEVEL_GAINS = (1.6, 2.2, 0.4)  # on position [1/s^2], velocity [1/s] and the integral of position [1/s^3]
CLIMB_GAINS = (4.0, 3.6, 0.4)
MAX_INTEGRAL_M_S2 = 5.5  # acceleration that MAX_TILT_RAD can compensate
MAX_ERROR_M = 2.0  # limit of the error, for a vehicle that cannot follow
MAX_TILT_RAD = radians(30.0)
ACCELERATION_M_S2, CLIMB_BRAKING_M_S2 = 2.0, 1.5
MIN_LIFT_RATIO, MAX_LIFT_RATIO = 0.3, 1.7  # vertical thrust over weight


@dataclass(frozen=True, slots=True)
class Loops:
    """Gains and limits of both loops and their delay, fitted with a motor lag of 50 ms."""

    tilt_gain_1_s: float
    yaw_gain_1_s: float
    rate_gain_1_s: float
    yaw_rate_gain_1_s: float
    delay_s: float
    max_rate_rad_s: float
    max_yaw_rate_rad_s: float


class AttitudeSetpoint(Struct, frozen=True, gc=False):
    """Attitude (FLU to ENU) and collective thrust (0 to 1) that the loops follow.

    `yaw_rate_rad_s` about the vertical is fed forward. `rates_rad_s` (p, q, r), if given, replaces the attitude.
    """

    quaternion: Quaternion
    thrust_norm: float
    yaw_rate_rad_s: float = 0.0
    rates_rad_s: Vector3 | None = None


class AttitudeControl:
    """Both loops of one vehicle, which follow setpoints after the delay of the loops, one per step of `dt_s`."""

    def __init__(self, loops: Loops, inertia_kg_m2: Vector3, first: AttitudeSetpoint, dt_s: float) -> None:
        """`first` is followed until the delay has passed."""
        jx, jy, jz = inertia_kg_m2
        self._angle_gains = (loops.tilt_gain_1_s, loops.yaw_gain_1_s)
        self._limits = (loops.max_rate_rad_s, loops.max_yaw_rate_rad_s)
        self._rate_gains = (jx * loops.rate_gain_1_s, jy * loops.rate_gain_1_s, jz * loops.yaw_rate_gain_1_s)
        self._delayed = deque([first] * max(1, round(loops.delay_s / dt_s)))

    def moments_n_m(self, setpoint: AttitudeSetpoint, measured: Quaternion, p: float, q: float, r: float) -> Vector3:
        """Moments about the body axes in the next step, from the measured attitude and body rates [rad/s].

        The outer loop turns the measured attitude towards the setpoint by the shorter rotation.
        """
        self._delayed.append(setpoint)
        setpoint = self._delayed.popleft()
        if setpoint.rates_rad_s is not None:
            to_p, to_q, to_r = setpoint.rates_rad_s
        else:
            tilt_gain, yaw_gain = self._angle_gains
            ex, ey, ez = rotation_error(measured, setpoint.quaternion)
            to_p, to_q, to_r = tilt_gain * ex, tilt_gain * ey, yaw_gain * ez
            if setpoint.yaw_rate_rad_s:
                w, x, y, z = measured
                to_p += setpoint.yaw_rate_rad_s * 2.0 * (x * z - w * y)
                to_q += setpoint.yaw_rate_rad_s * 2.0 * (y * z + w * x)
                to_r += setpoint.yaw_rate_rad_s * (1.0 - 2.0 * (x * x + y * y))
        most, most_yaw = self._limits
        if not (-most <= to_p <= most and -most <= to_q <= most and -most_yaw <= to_r <= most_yaw):  # rarely
            to_p, to_q, to_r = clamped(to_p, most), clamped(to_q, most), clamped(to_r, most_yaw)
        gain_p, gain_q, gain_r = self._rate_gains
        return (gain_p * (to_p - p), gain_q * (to_q - q), gain_r * (to_r - r))


def rotation_error(measured: Quaternion, wanted: Quaternion) -> Vector3:
    """Tilt about body x and y and rotation about body z from measured to wanted, small angles in rad; the same for q and -q.

    The rotation is split into a tilt and a yaw rotation after it, so that a large yaw error does not disturb the tilt: the
    direction of thrust has priority.
    """
    mw, mx, my, mz = measured
    w, x, y, z = wanted
    ew = mw * w + mx * x + my * y + mz * z
    ex = mw * x - mx * w - my * z + mz * y
    ey = mw * y + mx * z - my * w - mz * x
    ez = mw * z - mx * y + my * x - mz * w
    turn = sqrt(ew * ew + ez * ez)
    if turn < 1e-6:  # upside down: both directions are equally short
        return (2.0 * ex, 2.0 * ey, 0.0)
    yaw = 2.0 * ez / turn
    return (2.0 * (ew * ex - ez * ey) / turn, 2.0 * (ew * ey + ez * ex) / turn, yaw if ew >= 0.0 else -yaw)


@dataclass(slots=True)
class ControlAxis:
    """One axis: a target that moves to the goal, and the loop that follows the target."""

    gains: tuple[float, float, float]
    braking_m_s2: float
    goal_m: float = 0.0
    goal_m_s: float | None = None  # a speed to keep instead of a position
    max_speed_m_s: float = inf
    target_m: float = 0.0
    target_m_s: float = 0.0
    integral_m_s2: float = 0.0

    def stop_from(self, position_m: float, velocity_m_s: float) -> None:
        """Brake and hold where the braking ends. The integral is kept: the wind has not changed."""
        self.goal_m = position_m + velocity_m_s * abs(velocity_m_s) / (2.0 * self.braking_m_s2)
        self.goal_m_s = None
        self.target_m, self.target_m_s = position_m, velocity_m_s

    def acceleration_m_s2(self, position_m: float, velocity_m_s: float, dt_s: float) -> float:
        """Move the target by one step; returns the acceleration that follows it."""
        feed_forward = self._move_target(dt_s)
        k1, k2, ki = self.gains
        error = min(max(self.target_m - position_m, -MAX_ERROR_M), MAX_ERROR_M)
        if self.target_m == self.goal_m and self.goal_m_s is None:  # no windup while the target moves
            integral = self.integral_m_s2 + ki * error * dt_s
            self.integral_m_s2 = min(max(integral, -MAX_INTEGRAL_M_S2), MAX_INTEGRAL_M_S2)
        return feed_forward + k1 * error + k2 * (self.target_m_s - velocity_m_s) + self.integral_m_s2

    def _move_target(self, dt_s: float) -> float:
        """The target's acceleration over this step."""
        before = self.target_m_s
        left = self.goal_m - self.target_m
        if self.goal_m_s is not None:
            wanted = min(max(self.goal_m_s, -self.max_speed_m_s), self.max_speed_m_s)
        elif abs(left) <= max(1e-3, abs(before) * dt_s) and abs(before) <= 2.0 * ACCELERATION_M_S2 * dt_s:
            self.target_m, self.target_m_s = self.goal_m, 0.0
            return 0.0
        else:
            wanted = copysign(min(self.max_speed_m_s, sqrt(2.0 * self.braking_m_s2 * abs(left))), left)
        most = ACCELERATION_M_S2 * dt_s
        self.target_m_s = before + min(max(wanted - before, -most), most)
        self.target_m += self.target_m_s * dt_s
        return (self.target_m_s - before) / dt_s


class PositionControl:
    """Three axes in the local ENU frame and a heading; `braking_m_s2` applies to the horizontal axes.

    Goals and speeds of `axes` may be changed at any time.
    """

    def __init__(self, hover_thrust_norm: float, braking_m_s2: float) -> None:
        self._hover_thrust_norm = hover_thrust_norm
        self.axes = (
            ControlAxis(LEVEL_GAINS, braking_m_s2),
            ControlAxis(LEVEL_GAINS, braking_m_s2),
            ControlAxis(CLIMB_GAINS, CLIMB_BRAKING_M_S2),
        )
        self.yaw_rad = 0.0

    def stop(self, position_m: Vector3, velocity_m_s: Vector3, yaw_rad: float) -> None:
        """Brake and hold from now on."""
        self.yaw_rad = yaw_rad
        for axis, position, velocity in zip(self.axes, position_m, velocity_m_s, strict=True):
            axis.stop_from(position, velocity)

    def reset_integrals(self) -> None:
        """Before a new flight."""
        for axis in self.axes:
            axis.integral_m_s2 = 0.0

    def shift(self, offset_m: Vector3) -> None:
        """Shift goals and targets by the movement of the local frame: the vehicle has not moved."""
        for axis, offset in zip(self.axes, offset_m, strict=True):
            axis.goal_m += offset
            axis.target_m += offset

    def setpoint(self, position_m: Vector3, velocity_m_s: Vector3, euler_rad: Vector3, dt_s: float) -> AttitudeSetpoint:
        """Attitude and thrust for one step of `dt_s`."""
        x, y, z = (
            axis.acceleration_m_s2(position, velocity, dt_s)
            for axis, position, velocity in zip(self.axes, position_m, velocity_m_s, strict=True)
        )
        acceleration = limit_acceleration((x, y, z), MAX_TILT_RAD, MIN_LIFT_RATIO, MAX_LIFT_RATIO)
        roll, pitch, _ = euler_rad
        # Eq. 7 has no solution at large tilt; then the vehicle is levelled first.
        tilted = max(abs(roll), abs(pitch)) > 2.0 * MAX_TILT_RAD
        roll, pitch = (0.0, 0.0) if tilted else (roll, pitch)
        target = attitude_target(acceleration, self.yaw_rad, roll, pitch, self._hover_thrust_norm)
        quaternion = quaternion_from_euler(target.roll_rad, target.pitch_rad, target.yaw_rad)
        return AttitudeSetpoint(quaternion, min(1.0, target.thrust_norm))
