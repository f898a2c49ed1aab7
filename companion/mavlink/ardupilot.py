"""ArduCopter's manners on MAVLink: all that is not the same for every autopilot. Facts are of 4.5 to 4.7.

It says nothing but HEARTBEAT and STATUSTEXT until it is asked to. CURRENT_MODE it does not know; its HEARTBEAT comes as often
as asked and is the truth on mode and arming. Each command has one acknowledgement, and that one is true.

A quaternion that is not finite ends the process; one that is not of length 1, a mask of some rates only and a thrust to be
ignored make it stop in the air. After a stream's end it flies the last attitude and thrust for GUID_TIMEOUT, 3 s.
"""

from __future__ import annotations

from functools import lru_cache
from math import cos

from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.mavlink.commands import command_long, common_command
from companion.types import (
    AttitudeSample,
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    HeartbeatSample,
    LandedSample,
    PositionSample,
    SetMode,
    SystemSample,
    TakeOff,
    Telemetry,
    ThrustSample,
)

NAME = "ArduCopter"
MAV_AUTOPILOT = mavlink.MAV_AUTOPILOT_ARDUPILOTMEGA
# Planes and rovers say the same MAV_AUTOPILOT and mean other modes by the same numbers.
MAV_TYPES = frozenset(
    {
        mavlink.MAV_TYPE_QUADROTOR,
        mavlink.MAV_TYPE_COAXIAL,
        mavlink.MAV_TYPE_TRICOPTER,
        mavlink.MAV_TYPE_HEXAROTOR,
        mavlink.MAV_TYPE_OCTOROTOR,
        mavlink.MAV_TYPE_DECAROTOR,
        mavlink.MAV_TYPE_DODECAROTOR,
    }
)

# custom_mode is the mode's number.
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
# BRAKE stops and stays whatever the sticks say. LOITER would not do: without a transmitter it may sink as with a low stick.
MODES = {AutopilotMode.OFFBOARD: 4, AutopilotMode.RETURN: 6, AutopilotMode.LAND: 9, AutopilotMode.HOLD: 17}
MEANING = {number: mode for mode, number in MODES.items()}

# Message id -> microseconds between messages (MAV_CMD_SET_MESSAGE_INTERVAL). Of its estimator it tells no error in metres, so
# the GPS receiver's stands for it.
STREAMS_US = {
    mavlink.MAVLINK_MSG_ID_HEARTBEAT: 20_000,
    mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: 20_000,
    mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: 20_000,
    mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 100_000,
    mavlink.MAVLINK_MSG_ID_SYS_STATUS: 200_000,
    mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: 200_000,
    mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: 1_000_000,
}

LEAST_HZ: dict[type[Telemetry], tuple[str, float]] = {
    HeartbeatSample: ("heartbeats", 40.0),
    PositionSample: ("positions", 40.0),
    AttitudeSample: ("attitudes", 40.0),
    LandedSample: ("landed states", 2.0),
    SystemSample: ("battery states", 1.0),
    ThrustSample: ("thrusts", 5.0),
}

ATTITUDE_TYPE_MASK = 7  # ignore body rates
LEAST_COS_TILT = 0.1  # farther over, thrust is not divided by more


def is_its(heartbeat: MavlinkMessage) -> bool:
    """Is it an ArduCopter's HEARTBEAT?"""
    return heartbeat.autopilot == MAV_AUTOPILOT and heartbeat.type in MAV_TYPES


@lru_cache(maxsize=64)  # it is told 50 times a second and hardly ever another one
def mode_of(custom_mode: int) -> tuple[AutopilotMode, str]:
    """Meaning and ArduCopter's own name of a custom_mode."""
    return MEANING.get(custom_mode, AutopilotMode.OTHER), MODE_NAMES.get(custom_mode, f"mode {custom_mode}")


def thrust_of(target: AttitudeTarget) -> float:
    """Thrust of SET_ATTITUDE_TARGET, as GUID_OPTIONS bit 3 has it; without that bit it would be a climb rate.

    ArduCopter divides it by the cosine of the tilt (ATC_ANGLE_BOOST), which the attitude law has done already.
    """
    return target.thrust_norm * cos(target.roll_rad) * cos(target.pitch_rad)


def commanded_thrust(message: MavlinkMessage) -> float:
    """ATTITUDE_TARGET's along the body's axis: what it tells is not yet divided by the cosine of the tilt it wants.

    While it lands its vertical loop may want less than none, and its motors then give none.
    """
    _, x, y, _ = message.q
    cos_tilt = 1.0 - 2.0 * (x * x + y * y)
    thrust: float = message.thrust / max(LEAST_COS_TILT, cos_tilt)
    return 0.0 if -1.0 <= thrust < 0.0 else thrust


def command_for(request: AutopilotRequest, system_id: int) -> MavlinkMessage:
    """The COMMAND_LONG that asks for it."""
    match request:
        case SetMode(mode):
            flag = mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            return command_long(system_id, mavlink.MAV_CMD_DO_SET_MODE, flag, MODES[mode])
        case TakeOff(_, height_m):
            # Param 7 is above home, which is where it was armed.
            return command_long(system_id, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m)
        case _:
            return common_command(request, system_id)


def parameter_value(message: MavlinkMessage) -> float:
    """Of PARAM_VALUE: integers travel as numbers."""
    return float(message.param_value)
