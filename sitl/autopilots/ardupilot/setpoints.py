"""Setpoints of GUIDED from SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED, as ArduCopter interprets them."""

from __future__ import annotations

from math import isnan, nan

from companion.geometry.frames import (
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    flu_from_frd,
    quaternion_from_euler,
)
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.values import ZERO3, Vector3
from sitl.autopilots.autopilot import AutopilotAbortedError
from sitl.autopilots.setpoints import (
    IGNORE_ATTITUDE,
    IGNORE_POSITION,
    IGNORE_RATES,
    IGNORE_THROTTLE,
    IGNORE_VELOCITY,
    IGNORE_YAW,
    IGNORE_YAW_RATE,
)
from sitl.vehicle.attitude_control import AttitudeSetpoint
from sitl.vehicle.automatic_flight import Course

SQUARE_OF_UNIT_WITHIN = 1e-3
NO_VECTOR: Vector3 = (nan, nan, nan)


def setpoint_of(message: MavlinkMessage) -> AttitudeSetpoint | None:
    """The setpoint, None to stop. The thrust is as sent; its meaning depends on GUID_OPTIONS.

    Raises AutopilotAbortedError for a NaN quaternion, which aborts the real autopilot by a floating point exception.
    """
    mask = message.type_mask
    if mask & IGNORE_THROTTLE:
        return None
    no_rates = mask & sum(IGNORE_RATES)
    if not mask & IGNORE_ATTITUDE:
        if any(map(isnan, message.q)):
            raise AutopilotAbortedError("SET_ATTITUDE_TARGET with a quaternion that is not a number")
        if abs(sum(part * part for part in message.q) - 1.0) > SQUARE_OF_UNIT_WITHIN:
            return None
    if no_rates not in (0, sum(IGNORE_RATES)):
        return None
    p, q, r = flu_from_frd((message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate))
    rates = ZERO3 if no_rates else (p, q, r)
    if mask & IGNORE_ATTITUDE:
        return AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), message.thrust, rates_rad_s=rates)
    euler = euler_enu_from_ned(*euler_from_quaternion(tuple(message.q)))
    return AttitudeSetpoint(quaternion_from_euler(*euler), message.thrust, yaw_rate_rad_s=rates[2])


def course_of(message: MavlinkMessage) -> Course | None:
    """The course, None to stop. A position or velocity is given with all axes or none; accelerations are not followed."""
    mask = message.type_mask
    position = NO_VECTOR if mask & sum(IGNORE_POSITION) else enu_from_ned((message.x, message.y, message.z))
    velocity = NO_VECTOR if mask & sum(IGNORE_VELOCITY) else enu_from_ned((message.vx, message.vy, message.vz))
    if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or (position is NO_VECTOR and velocity is NO_VECTOR):
        return None
    return Course(
        position,
        velocity,
        nan if mask & IGNORE_YAW else euler_enu_from_ned(0.0, 0.0, message.yaw)[2],
        0.0 if mask & IGNORE_YAW_RATE else flu_from_frd((0.0, 0.0, message.yaw_rate))[2],
    )
