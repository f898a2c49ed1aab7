"""Type masks of SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED, common to all makes."""

from __future__ import annotations

from dataclasses import dataclass

from companion.types.values import Vector3

IGNORE_RATES = (0x01, 0x02, 0x04)  # of type_mask: roll, pitch, yaw
IGNORE_THROTTLE, IGNORE_ATTITUDE = 0x40, 0x80
IGNORE_POSITION, IGNORE_VELOCITY = (0x01, 0x02, 0x04), (0x08, 0x10, 0x20)  # of type_mask: x, y, z
IGNORE_YAW, IGNORE_YAW_RATE = 0x400, 0x800
MAX_DISTANCE_M = 10_000.0


@dataclass(frozen=True, slots=True)
class Course:
    """Position or velocity per axis in the local ENU frame, NaN if not given; the position has priority."""

    position_m: Vector3
    velocity_m_s: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float
