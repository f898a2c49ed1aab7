"""PX4, version 1.16: its MAVLink dialect here, its modes, procedures and parameters in `profile.py`."""

from __future__ import annotations

import struct
from functools import lru_cache
from math import nan

from companion.geometry.frames import Quaternion
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.mavlink.dialect import MIN_RATE_HZ_OF_ALL, LogHabits, command_long, common_command, origin_message
from companion.mavlink.px4.profile import PROFILE as PROFILE
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    ModeSample,
    SetMode,
    SetOrigin,
    TakeOff,
)

NAME = "PX4"
LOGS = LogHabits(".ulg", silent_without_logs=True)  # in order of its folders
MAV_AUTOPILOT = mavlink.MAV_AUTOPILOT_PX4
MAV_TYPES: frozenset[int] = frozenset()  # every vehicle type is accepted

# custom_mode holds the main mode in its third byte and the sub mode in its fourth.
MAIN_MODES = {
    1: "MANUAL",
    2: "ALTCTL",
    3: "POSCTL",
    4: "AUTO",
    5: "ACRO",
    6: "OFFBOARD",
    7: "STABILIZED",
    8: "RATTITUDE",
}
AUTO_MODES = {1: "READY", 2: "TAKEOFF", 3: "LOITER", 4: "MISSION", 5: "RTL", 6: "LAND", 8: "FOLLOW", 9: "PRECLAND"}
MODES = {
    AutopilotMode.OFFBOARD: (6, 0),
    AutopilotMode.TAKEOFF: (4, 2),
    AutopilotMode.HOLD: (4, 3),
    AutopilotMode.LAND: (4, 6),
    AutopilotMode.RETURN: (4, 5),
}
MEANING = {numbers: mode for mode, numbers in MODES.items()}

# Message id -> microseconds between messages (MAV_CMD_SET_MESSAGE_INTERVAL); -1 is off. CURRENT_MODE reports a mode change
# within 20 ms; HEARTBEAT stays at 1 Hz regardless of requests. Unused messages are off to save the companion's CPU time.
STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20_000,
    mavlink.MAVLINK_MSG_ID_CURRENT_MODE: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 20_000,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 100_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 200_000,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1_000_000,
    mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: 200_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE: -1,
    mavlink.MAVLINK_MSG_ID_ODOMETRY: -1,
    mavlink.MAVLINK_MSG_ID_HIGHRES_IMU: -1,
}

# CURRENT_MODE comes at every change and otherwise twice a second.
MIN_RATE_HZ = MIN_RATE_HZ_OF_ALL | {ModeSample: ("modes", 1.2)}

ATTITUDE_TYPE_MASK = 7  # ignore body rates; bit 6 (throttle ignore) would mean zero thrust


@lru_cache(maxsize=64)  # called 50 times per second, mostly with the same mode
def mode_of(custom_mode: int) -> tuple[AutopilotMode, str]:
    """Meaning of a custom_mode, and its PX4 name."""
    main, sub = custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF
    name = MAIN_MODES.get(main, f"mode {main}")
    if main == 4:
        name += "." + AUTO_MODES.get(sub, str(sub))
    return MEANING.get((main, sub if main == 4 else 0), AutopilotMode.OTHER), name


def thrust_of(target: AttitudeTarget) -> float:
    """The thrust field of SET_ATTITUDE_TARGET: along the body z axis, 0 to 1."""
    return target.thrust_norm


def commanded_thrust(thrust: float, _quaternion: Quaternion) -> float:
    """Thrust along the body z axis, from ATTITUDE_TARGET."""
    return thrust


def command_for(request: AutopilotRequest, system_id: int) -> MavlinkMessage:
    """The MAVLink message of this request."""
    match request:
        case SetMode(mode):
            main, sub = MODES[mode]
            return command_long(
                system_id, mavlink.MAV_CMD_DO_SET_MODE, mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, main, sub
            )
        case TakeOff(_, altitude_amsl_m):
            # NaN: at the present position and heading. Param 7 is above mean sea level.
            return command_long(system_id, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, nan, nan, nan, param7=altitude_amsl_m)
        case SetOrigin(latitude_deg, longitude_deg, _):
            # With height by vision every restart of it sets the altitude above sea level to minus z: with another altitude
            # than 0 the vehicle would climb away.
            return origin_message(system_id, latitude_deg, longitude_deg, 0.0)
        case _:
            return common_command(request, system_id)


def parameter_value(message: MavlinkMessage) -> float:
    """The value in PARAM_VALUE. PX4 sends integers bytewise in the float field."""
    if message.param_type == mavlink.MAV_PARAM_TYPE_REAL32:
        return float(message.param_value)
    integer: int = struct.unpack("<i", struct.pack("<f", message.param_value))[0]
    return float(integer)
