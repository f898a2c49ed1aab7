"""What the fields of SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED mean to every autopilot."""

from __future__ import annotations

from dataclasses import dataclass

from companion.types import Vector3

IGNORE_RATES = (0x01, 0x02, 0x04)  # of type_mask: roll, pitch, yaw
IGNORE_THROTTLE, IGNORE_ATTITUDE = 0x40, 0x80
IGNORE_POSITION, IGNORE_VELOCITY = (0x01, 0x02, 0x04), (0x08, 0x10, 0x20)  # of type_mask: x, y, z
IGNORE_YAW, IGNORE_YAW_RATE = 0x400, 0x800
MAX_DISTANCE_M = 10_000.0


@dataclass(frozen=True, slots=True)
class Course:
    """A place or a velocity in the local ENU frame, axis by axis; NaN where none is given. The place goes before."""

    position_m: Vector3
    velocity_m_s: Vector3
    yaw_rad: float
    yaw_rate_rad_s: float
