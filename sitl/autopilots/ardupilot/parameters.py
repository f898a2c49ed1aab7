"""Parameters of the stand-in ArduCopter, by the names of 4.5 and 4.6. All are sent as floats, by value."""

from __future__ import annotations

from collections.abc import Mapping

from companion.mavlink.codec import mavlink
from sitl.autopilots.parameters import REAL32, StandInParameters

M = mavlink
INTEGERS = (
    (M.MAV_PARAM_TYPE_INT8, 2**7),
    (M.MAV_PARAM_TYPE_INT16, 2**15),
    (M.MAV_PARAM_TYPE_INT32, 2**31),
)
# A few are small numbers in a wide type.
WIDE: dict[str, int] = {
    "ANGLE_MAX": M.MAV_PARAM_TYPE_INT16,
    "ARMING_CHECK": M.MAV_PARAM_TYPE_INT32,
    "FS_OPTIONS": M.MAV_PARAM_TYPE_INT32,
    "GUID_OPTIONS": M.MAV_PARAM_TYPE_INT32,
    "LAND_SPEED": M.MAV_PARAM_TYPE_INT16,
    "LAND_SPEED_HIGH": M.MAV_PARAM_TYPE_INT16,
    "LOG_BITMASK": M.MAV_PARAM_TYPE_INT32,
    "PILOT_SPEED_DN": M.MAV_PARAM_TYPE_INT16,
    "PILOT_SPEED_UP": M.MAV_PARAM_TYPE_INT16,
    "RTL_ALT": M.MAV_PARAM_TYPE_INT32,
    "RTL_ALT_FINAL": M.MAV_PARAM_TYPE_INT16,
    "RTL_LOIT_TIME": M.MAV_PARAM_TYPE_INT32,
    "SYSID_MYGCS": M.MAV_PARAM_TYPE_INT16,
    "SYSID_THISMAV": M.MAV_PARAM_TYPE_INT16,
}

DEFAULTS: dict[str, float | int] = {
    "ANGLE_MAX": 3000,
    "ARMING_CHECK": 1,
    "ATC_ANGLE_BOOST": 1,
    "ATC_INPUT_TC": 0.15,
    "BATT_CAPACITY": 3300,
    "BATT_CRT_VOLT": 0.0,
    "BATT_FS_CRT_ACT": 0,
    "BATT_FS_LOW_ACT": 0,
    "BATT_LOW_VOLT": 10.5,
    "BATT_MONITOR": 4,
    "DISARM_DELAY": 10,
    "EK3_ENABLE": 1,
    "EK3_SRC1_POSXY": 3,
    "EK3_SRC1_POSZ": 1,
    "FENCE_ACTION": 1,
    "FENCE_ALT_MAX": 100.0,
    "FENCE_ALT_MIN": -10.0,
    "FENCE_AUTOENABLE": 0,
    "FENCE_ENABLE": 0,
    "FENCE_MARGIN": 2.0,
    "FENCE_RADIUS": 150.0,
    "FENCE_TOTAL": 0,
    "FENCE_TYPE": 7,
    "FRAME_CLASS": 1,
    "FRAME_TYPE": 0,
    "FS_CRASH_CHECK": 1,
    "FS_EKF_ACTION": 1,
    "FS_EKF_THRESH": 0.8,
    "FS_GCS_ENABLE": 0,
    "FS_GCS_TIMEOUT": 5.0,
    "FS_OPTIONS": 16,
    "FS_THR_ENABLE": 1,
    "GUID_OPTIONS": 0,
    "GUID_TIMEOUT": 3.0,
    "LAND_ALT_LOW": 1000.0,
    "LAND_SPEED": 50,
    "LAND_SPEED_HIGH": 0,
    "LOG_BACKEND_TYPE": 1,
    "LOG_BITMASK": 180222,
    "MOT_HOVER_LEARN": 2,
    "MOT_SPIN_MAX": 0.95,
    "MOT_SPIN_MIN": 0.15,
    "MOT_THST_EXPO": 0.65,
    "MOT_THST_HOVER": 0.39,
    "PILOT_SPEED_DN": 0,
    "PILOT_SPEED_UP": 250,
    "RTL_ALT": 1500,
    "RTL_ALT_FINAL": 0,
    "RTL_CONE_SLOPE": 3.0,
    "RTL_LOIT_TIME": 5000,
    "SCHED_LOOP_RATE": 400,
    "SERIAL0_BAUD": 115,
    "SERIAL0_PROTOCOL": 2,
    "SYSID_ENFORCE": 0,
    "SYSID_MYGCS": 255,
    "SYSID_THISMAV": 1,
    "WPNAV_ACCEL": 250.0,
    "WPNAV_SPEED": 1000.0,
    "WPNAV_SPEED_DN": 150.0,
    "WPNAV_SPEED_UP": 250.0,
    "WP_YAW_BEHAVIOR": 2,
}


class ArduPilotParameters(StandInParameters):
    """The type in a client's PARAM_SET is ignored."""

    def __init__(self, system_id: int, overrides: Mapping[str, float]) -> None:
        """Raises KeyError for a parameter that does not exist."""
        super().__init__(DEFAULTS | {"SYSID_THISMAV": system_id}, overrides)

    def _from_wire(self, _name: str, value: float, _kind: int) -> float | None:
        return value

    def _to_wire(self, name: str) -> float:
        return float(self.values[name])

    def _kind(self, name: str) -> int:
        if not isinstance(DEFAULTS[name], int):
            return REAL32
        return WIDE.get(name) or next(kind for kind, limit in INTEGERS if abs(DEFAULTS[name]) < limit)
