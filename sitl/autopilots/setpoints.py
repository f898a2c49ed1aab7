"""Type masks of SET_ATTITUDE_TARGET and SET_POSITION_TARGET_LOCAL_NED, common to all makes."""

from __future__ import annotations

IGNORE_RATES = (0x01, 0x02, 0x04)  # of type_mask: roll, pitch, yaw
IGNORE_THROTTLE, IGNORE_ATTITUDE = 0x40, 0x80
IGNORE_POSITION, IGNORE_VELOCITY = (0x01, 0x02, 0x04), (0x08, 0x10, 0x20)  # of type_mask: x, y, z
IGNORE_YAW, IGNORE_YAW_RATE = 0x400, 0x800
MAX_DISTANCE_M = 10_000.0
