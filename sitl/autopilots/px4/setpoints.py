"""Setpoints of OFFBOARD from SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED, as PX4 interprets them."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite, nan, sqrt

from companion.geometry.frames import (
    Quaternion,
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    flu_from_frd,
    quaternion_from_euler,
)
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.values import Vector3
from sitl.autopilots.setpoints import (
    IGNORE_ATTITUDE,
    IGNORE_POSITION,
    IGNORE_RATES,
    IGNORE_THROTTLE,
    IGNORE_VELOCITY,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
    MAX_DISTANCE_M,
)
from sitl.vehicle.attitude_control import AttitudeSetpoint
from sitl.vehicle.automatic_flight import Course


def setpoint_of(message: MavlinkMessage, attitude: Quaternion) -> AttitudeSetpoint | None:
    """The setpoint, None for a message without one; `attitude` is the present attitude.

    Nothing is rejected: throttle ignore, NaN or negative thrust, and a q that is not a rotation make the vehicle fall.
    """
    thrust = message.thrust
    falls = message.type_mask & IGNORE_THROTTLE or not isfinite(thrust) or thrust < 0.0
    thrust = 0.0 if falls else min(thrust, 1.0)
    rates = flu_from_frd(_given_rates(message))
    if message.type_mask & IGNORE_ATTITUDE:
        if message.type_mask & (IGNORE_RATES[0] | IGNORE_RATES[1]):
            return None
        return AttitudeSetpoint(attitude, thrust, rates_rad_s=rates)
    quaternion = _unit(message.q)
    if quaternion is None:
        return AttitudeSetpoint(attitude, 0.0)
    euler = euler_enu_from_ned(*euler_from_quaternion(quaternion))
    return AttitudeSetpoint(
        quaternion_from_euler(*euler), thrust, yaw_rate_rad_s=rates[2]
    )  # fed forward, about the vertical


def course_of(message: MavlinkMessage) -> Course | None:
    """The course of a SET_POSITION_TARGET_LOCAL_NED, None without one. Accelerations are not followed."""
    mask = message.type_mask
    position = _given((message.x, message.y, message.z), IGNORE_POSITION, mask)
    velocity = _given((message.vx, message.vy, message.vz), IGNORE_VELOCITY, mask)
    if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or not any(map(isfinite, (*position, *velocity))):
        return None
    no_yaw = mask & IGNORE_YAW or not isfinite(message.yaw)
    no_rate = mask & IGNORE_YAW_RATE or not isfinite(message.yaw_rate)
    return Course(
        enu_from_ned(position),
        enu_from_ned(velocity),
        nan if no_yaw else euler_enu_from_ned(0.0, 0.0, message.yaw)[2],
        0.0 if no_rate else flu_from_frd((0.0, 0.0, message.yaw_rate))[2],
    )


def _given(values: Vector3, ignored: tuple[int, int, int], mask: int) -> Vector3:
    x, y, z = (
        value if not mask & bit and abs(value) <= MAX_DISTANCE_M else nan
        for value, bit in zip(values, ignored, strict=True)
    )
    return (x, y, z)


def _given_rates(message: MavlinkMessage) -> Vector3:
    """Body rates FRD of a SET_ATTITUDE_TARGET; zero if masked or not finite."""
    mask, rates = message.type_mask, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    p, q, r = (
        0.0 if mask & ignored or not isfinite(rate) else rate for ignored, rate in zip(IGNORE_RATES, rates, strict=True)
    )
    return (p, q, r)


def _unit(q: Sequence[float]) -> Quaternion | None:
    """The rotation of a scaled or negated quaternion; None for one that is not a rotation."""
    norm = sqrt(sum(part * part for part in q))
    if not isfinite(norm) or norm < 1e-6:
        return None
    w, x, y, z = q
    return (w / norm, x / norm, y / norm, z / norm)
