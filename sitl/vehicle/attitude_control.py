"""Moments from attitude setpoints: a cascade of attitude and rate loops with the measured step responses of an autopilot."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import radians, sqrt

from msgspec import Struct

from companion.geometry.frames import Quaternion
from companion.geometry.vectors import clamped
from companion.types.values import Vector3


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


# A roll step of 10 degrees reaches 10, 50 and 90 % after 117, 198 and 278 ms and overshoots by 1.5 degrees; a yaw step of 60
# degrees reaches 90 % after 0.81 s, at 109 deg/s at most. The gains correspond to MC_ROLL_P, MC_YAW_P and the rate gains.
PX4_LOOPS = Loops(
    tilt_gain_1_s=6.5,
    yaw_gain_1_s=2.5,
    rate_gain_1_s=12.5,
    yaw_rate_gain_1_s=7.5,
    delay_s=0.028,
    max_rate_rad_s=radians(220.0),
    max_yaw_rate_rad_s=radians(109.0),
)


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
        self._loops = loops
        jx, jy, jz = inertia_kg_m2
        self._rate_gains = (jx * loops.rate_gain_1_s, jy * loops.rate_gain_1_s, jz * loops.yaw_rate_gain_1_s)
        self._delayed = deque([first] * max(1, round(loops.delay_s / dt_s)))

    def moments_n_m(self, setpoint: AttitudeSetpoint, measured: Quaternion, p: float, q: float, r: float) -> Vector3:
        """Moments about the body axes in the next step, from the measured attitude and body rates [rad/s]."""
        self._delayed.append(setpoint)
        wanted_p, wanted_q, wanted_r = self._wanted_rates(self._delayed.popleft(), measured)
        gain_p, gain_q, gain_r = self._rate_gains
        return (gain_p * (wanted_p - p), gain_q * (wanted_q - q), gain_r * (wanted_r - r))

    def _wanted_rates(self, setpoint: AttitudeSetpoint, measured: Quaternion) -> Vector3:
        """Body rates p, q, r [rad/s] that turn the measured attitude towards the setpoint by the shorter rotation."""
        loops = self._loops
        if setpoint.rates_rad_s is not None:
            p, q, r = setpoint.rates_rad_s
        else:
            ex, ey, ez = rotation_error(measured, setpoint.quaternion)
            p, q, r = loops.tilt_gain_1_s * ex, loops.tilt_gain_1_s * ey, loops.yaw_gain_1_s * ez
            if setpoint.yaw_rate_rad_s:
                w, x, y, z = measured
                p += setpoint.yaw_rate_rad_s * 2.0 * (x * z - w * y)
                q += setpoint.yaw_rate_rad_s * 2.0 * (y * z + w * x)
                r += setpoint.yaw_rate_rad_s * (1.0 - 2.0 * (x * x + y * y))
        most, most_yaw = loops.max_rate_rad_s, loops.max_yaw_rate_rad_s
        if -most <= p <= most and -most <= q <= most and -most_yaw <= r <= most_yaw:  # nearly always
            return (p, q, r)
        return (clamped(p, most), clamped(q, most), clamped(r, most_yaw))


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
