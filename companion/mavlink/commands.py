"""Commands that are the same for every autopilot, and the requests that a COMMAND_ACK answers."""

from __future__ import annotations

from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.autopilot import Arm, Disarm, RequestOrigin, RequestParameter, SetMode, TakeOff

# Command of a COMMAND_ACK -> requests that it may answer.
ANSWERS: dict[int, tuple[type, ...]] = {
    mavlink.MAV_CMD_DO_SET_MODE: (SetMode,),
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: (Arm, Disarm),
    mavlink.MAV_CMD_NAV_TAKEOFF: (TakeOff,),
    mavlink.MAV_CMD_REQUEST_MESSAGE: (RequestOrigin,),
}


def command_long(system_id: int, command: int, *parameters: float) -> MavlinkMessage:
    """COMMAND_LONG to the autopilot component; parameters left out are zero.

    It addresses one system and component: PX4 silently ignores commands to 0/0.
    """
    padded = [float(p) for p in parameters] + [0.0] * (7 - len(parameters))
    return mavlink.MAVLink_command_long_message(system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, command, 0, *padded)


def common_command(request: Arm | Disarm | RequestOrigin | RequestParameter, system_id: int) -> MavlinkMessage:
    """The message of a request that PX4 and ArduCopter take in the same form."""
    match request:
        case Arm():
            return command_long(system_id, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
        case Disarm():
            return command_long(system_id, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
        case RequestOrigin():
            return command_long(system_id, mavlink.MAV_CMD_REQUEST_MESSAGE, mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN)
        case RequestParameter(name):
            by_name = -1
            return mavlink.MAVLink_param_request_read_message(
                system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, name.encode(), by_name
            )


def stream_request(system_id: int, message_id: int, interval_us: int) -> MavlinkMessage:
    """MAV_CMD_SET_MESSAGE_INTERVAL; interval -1 is off."""
    return command_long(system_id, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
