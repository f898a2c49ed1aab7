"""Attitude setpoint -> moments: the cascade of PX4's attitude and rate loops, tuned to its measured step response.

A roll step of 10 degrees passes 10, 50 and 90 % at 117, 198 and 278 ms and overshoots by 1.5 degrees; a yaw step of 60 degrees
passes 90 % at 0.81 s and turns at 109 deg/s at most.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from math import radians

from companion.frames import Quaternion
from companion.types import Vector3

ATTITUDE_GAIN_1_S = 7.0
YAW_GAIN_1_S = 2.8
RATE_GAIN_1_S = 13.3
YAW_RATE_GAIN_1_S = 5.5
MAX_RATE_RAD_S = radians(220.0)  # MC_ROLLRATE_MAX
MAX_YAW_RATE_RAD_S = radians(109.0)
DELAY_S = 0.042  # from a setpoint's arrival to the motors' first answer


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What the loops follow: attitude (FLU to ENU), collective thrust 0..1, or body rates where `rates_rad_s` is given."""

    quaternion: Quaternion
    thrust_norm: float
    rates_rad_s: Vector3 | None = None


class DelayLine:
    """Hands a setpoint on after DELAY_S of steps of `dt_s`."""

    def __init__(self, first: Setpoint, dt_s: float) -> None:
        self._line = deque([first] * max(1, round(DELAY_S / dt_s)))

    def pass_on(self, setpoint: Setpoint) -> Setpoint:
        self._line.append(setpoint)
        return self._line.popleft()


def wanted_rates(setpoint: Setpoint, measured: Quaternion) -> Vector3:
    """Body rates p, q, r [rad/s] that turn the measured attitude towards the setpoint's the short way."""
    if setpoint.rates_rad_s is not None:
        p, q, r = setpoint.rates_rad_s
    else:
        ex, ey, ez = _rotation_error(measured, setpoint.quaternion)
        p, q, r = ATTITUDE_GAIN_1_S * ex, ATTITUDE_GAIN_1_S * ey, YAW_GAIN_1_S * ez
    return (
        _clamped(p, MAX_RATE_RAD_S),
        _clamped(q, MAX_RATE_RAD_S),
        _clamped(r, MAX_YAW_RATE_RAD_S),
    )


def moments(rates_wanted: Vector3, rates: Vector3, inertia_kg_m2: Vector3) -> Vector3:
    """Moments [N m] about the body axes."""
    return (
        inertia_kg_m2[0] * RATE_GAIN_1_S * (rates_wanted[0] - rates[0]),
        inertia_kg_m2[1] * RATE_GAIN_1_S * (rates_wanted[1] - rates[1]),
        inertia_kg_m2[2] * YAW_RATE_GAIN_1_S * (rates_wanted[2] - rates[2]),
    )


def _rotation_error(measured: Quaternion, wanted: Quaternion) -> Vector3:
    """Twice the vector part of measured^-1 * wanted: the small rotation in body axes, the same for q and -q."""
    mw, mx, my, mz = measured
    w, x, y, z = wanted
    ew = mw * w + mx * x + my * y + mz * z
    sign = 2.0 if ew >= 0.0 else -2.0
    return (
        sign * (mw * x - mx * w - my * z + mz * y),
        sign * (mw * y + mx * z - my * w - mz * x),
        sign * (mw * z - mx * y + my * x - mz * w),
    )


def _clamped(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
