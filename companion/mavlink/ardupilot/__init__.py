"""ArduCopter, versions 4.5 to 4.7: its MAVLink dialect here, its modes, procedures and parameters in `profile.py`.

ArduCopter sends only HEARTBEAT and STATUSTEXT until other messages are requested. It does not support CURRENT_MODE; HEARTBEAT
comes at the requested rate and reports mode and arming. Each command has one COMMAND_ACK, which is final.

A quaternion that is not finite aborts the autopilot's process. A quaternion that is not of unit length, a type_mask with only
some rates ignored, or an ignored throttle make it brake. When the setpoint stream ends it keeps the last attitude and thrust
for GUID_TIMEOUT (3 s).
"""

from __future__ import annotations

from functools import lru_cache
from math import cos

from companion.geometry.frames import Quaternion
from companion.mavlink.ardupilot.profile import PROFILE as PROFILE
from companion.mavlink.codec import MavlinkMessage, mavlink, named
from companion.mavlink.dialect import MIN_RATE_HZ_OF_ALL, LogHabits, command_long, common_command, origin_message
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    HeartbeatSample,
    SetMode,
    SetOrigin,
    TakeOff,
)

NAME = "ArduCopter"
LOGS = LogHabits(".bin", numbered_by_time=True, ends_when_read=True)
MAV_AUTOPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
# Planes and rovers report the same MAV_AUTOPILOT with other meanings of the mode numbers.
MAV_TYPES = named("MAV_TYPE", "QUADROTOR COAXIAL TRICOPTER HEXAROTOR OCTOROTOR DECAROTOR DODECAROTOR")

# custom_mode is the mode number.
MODE_NAMES = {
    0: "STABILIZE",
    1: "ACRO",
    2: "ALT_HOLD",
    3: "AUTO",
    4: "GUIDED",
    5: "LOITER",
    6: "RTL",
    7: "CIRCLE",
    9: "LAND",
    11: "DRIFT",
    13: "SPORT",
    14: "FLIP",
    15: "AUTOTUNE",
    16: "POSHOLD",
    17: "BRAKE",
    18: "THROW",
    19: "AVOID_ADSB",
    20: "GUIDED_NOGPS",
    21: "SMART_RTL",
    22: "FLOWHOLD",
    23: "FOLLOW",
    24: "ZIGZAG",
    25: "SYSTEMID",
    26: "AUTOROTATE",
    27: "AUTO_RTL",
    28: "TURTLE",
}
# BRAKE stops and holds position regardless of the sticks. LOITER may sink without a transmitter, as with a low stick.
MODES = {AutopilotMode.OFFBOARD: 4, AutopilotMode.RETURN: 6, AutopilotMode.LAND: 9, AutopilotMode.HOLD: 17}
MEANING = {number: mode for mode, number in MODES.items()}

# Message id -> microseconds between messages (MAV_CMD_SET_MESSAGE_INTERVAL). ArduCopter does not report the error of its
# estimator in metres; that of the GPS receiver (GPS_RAW_INT) is used instead.
STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 20_000,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 20_000,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 100_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 200_000,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_HOME_POSITION: 1_000_000,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 200_000,
}

MIN_RATE_HZ = {HeartbeatSample: ("heartbeats", 40.0)} | MIN_RATE_HZ_OF_ALL

ATTITUDE_TYPE_MASK = 7  # ignore body rates
LEAST_COS_TILT = 0.1  # smallest divisor of the thrust


@lru_cache(maxsize=64)  # called 50 times per second, mostly with the same mode
def mode_of(custom_mode: int) -> tuple[AutopilotMode, str]:
    """Meaning of a custom_mode, and its ArduCopter name."""
    return MEANING.get(custom_mode, AutopilotMode.OTHER), MODE_NAMES.get(custom_mode, f"mode {custom_mode}")


def thrust_of(target: AttitudeTarget) -> float:
    """The thrust field of SET_ATTITUDE_TARGET with GUID_OPTIONS bit 3 set; without that bit it would be a climb rate.

    ArduCopter divides it by the cosine of the tilt (ATC_ANGLE_BOOST), which the attitude law has already done.
    """
    return target.thrust_norm * cos(target.roll_rad) * cos(target.pitch_rad)


def commanded_thrust(thrust: float, quaternion: Quaternion) -> float:
    """Thrust along the body z axis. ATTITUDE_TARGET reports it before the division by the cosine of the wanted tilt.

    During landing the vertical loop may report a negative thrust; the motors then give none.
    """
    _, x, y, _ = quaternion
    cos_tilt = 1.0 - 2.0 * (x * x + y * y)
    along_z = thrust / max(LEAST_COS_TILT, cos_tilt)
    return 0.0 if -1.0 <= along_z < 0.0 else along_z


def command_for(request: AutopilotRequest, system_id: int) -> MavlinkMessage:
    """The MAVLink message of this request."""
    match request:
        case SetMode(mode):
            flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            return command_long(system_id, mavlink.MAV_CMD_DO_SET_MODE, flag, MODES[mode])
        case TakeOff(height_m):
            # Param 7 is the height above home, the position of arming.
            return command_long(system_id, mavlink.MAV_CMD_NAV_TAKEOFF, param7=height_m)
        case SetOrigin(latitude_deg, longitude_deg, altitude_amsl_m):
            # With another altitude than the field's the height drifts while it is disarmed.
            return origin_message(system_id, latitude_deg, longitude_deg, altitude_amsl_m)
        case _:
            return common_command(request, system_id)


def parameter_value(message: MavlinkMessage) -> float:
    """The value in PARAM_VALUE. ArduPilot sends integers as numbers."""
    return float(message.param_value)
