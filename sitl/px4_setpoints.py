"""SET_ATTITUDE_TARGET -> what the stand-in follows in OFFBOARD, read as PX4 reads it."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, sqrt

from companion.frames import Quaternion, euler_enu_from_ned, euler_from_quaternion, quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage
from companion.types import Vector3
from sitl.attitude_control import Setpoint
from sitl.body_axes import flu_from_frd

IGNORE_RATES = (0x01, 0x02, 0x04)  # of type_mask: roll, pitch, yaw
IGNORE_THROTTLE, IGNORE_ATTITUDE = 0x40, 0x80


def setpoint_of(message: MavlinkMessage, attitude: Quaternion) -> Setpoint | None:
    """None where it asks for nothing; `attitude` is the present one.

    Nothing is refused: throttle ignore, a thrust that is NaN or negative and a q that is no rotation make the vehicle fall.
    """
    thrust = message.thrust
    falls = message.type_mask & IGNORE_THROTTLE or not isfinite(thrust) or thrust < 0.0
    thrust = 0.0 if falls else min(thrust, 1.0)
    rates = flu_from_frd(_given_rates(message))
    if message.type_mask & IGNORE_ATTITUDE:
        if message.type_mask & (IGNORE_RATES[0] | IGNORE_RATES[1]):
            return None
        return Setpoint(attitude, thrust, rates_rad_s=rates)
    quaternion = _unit(message.q)
    if quaternion is None:
        return Setpoint(attitude, 0.0)
    euler = euler_enu_from_ned(*euler_from_quaternion(quaternion))
    return Setpoint(quaternion_from_euler(*euler), thrust, yaw_rate_rad_s=rates[2])  # fed forward, about the vertical


def _given_rates(message: MavlinkMessage) -> Vector3:
    """Body rates FRD of a SET_ATTITUDE_TARGET; zero where they are masked or no numbers."""
    mask, rates = message.type_mask, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    p, q, r = (
        0.0 if mask & ignored or not isfinite(rate) else rate for ignored, rate in zip(IGNORE_RATES, rates, strict=True)
    )
    return (p, q, r)


def _unit(q: Sequence[float]) -> Quaternion | None:
    """The rotation that a scaled or negated quaternion still means; None where it means none."""
    norm = sqrt(sum(part * part for part in q))
    if not isfinite(norm) or norm < 1e-6:
        return None
    w, x, y, z = q
    return (w / norm, x / norm, y / norm, z / norm)
