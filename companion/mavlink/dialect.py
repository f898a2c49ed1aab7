"""What differs between the autopilot types in MAVLink (`Dialect`), and the commands that are the same for all of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from companion.core.autopilot import AutopilotProfile
from companion.geometry.frames import Quaternion
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types.autopilot import (
    Arm,
    AttitudeSample,
    AttitudeTarget,
    AutopilotMode,
    AutopilotRequest,
    Disarm,
    LandedSample,
    PositionSample,
    RequestOrigin,
    RequestParameter,
    SetMode,
    SystemSample,
    TakeOff,
    Telemetry,
    ThrustSample,
)


@dataclass(frozen=True, slots=True)
class LogHabits:
    """How an autopilot type keeps its flight logs.

    `numbered_by_time`: the log with the highest number is the newest, whatever its date. `ends_when_read`: reading the newest
    log ends it and begins another. `silent_without_logs`: a request for the list has no answer where there are none.
    """

    suffix: str
    numbered_by_time: bool = False
    ends_when_read: bool = False
    silent_without_logs: bool = False


class Dialect(Protocol):
    """What the product knows of an autopilot type: a folder, which is a package with these names."""

    NAME: str  # for display
    MAV_AUTOPILOT: int
    MAV_TYPES: frozenset[int]  # vehicle types that are accepted; empty for any
    PROFILE: AutopilotProfile  # what the core knows of it
    LOGS: LogHabits
    STREAMS_US: dict[int, int]  # requested message intervals: message id -> microseconds; -1 is off
    # Telemetry that the agent needs: name and lowest rate. Below it all streams are requested again.
    MIN_RATE_HZ: dict[type[Telemetry], tuple[str, float]]
    ATTITUDE_TYPE_MASK: int  # type_mask of SET_ATTITUDE_TARGET with attitude and thrust

    def mode_of(self, custom_mode: int) -> tuple[AutopilotMode, str]:
        """Meaning of a custom_mode, and its name in the autopilot's documentation."""

    def thrust_of(self, target: AttitudeTarget) -> float:
        """The thrust field of SET_ATTITUDE_TARGET for this target."""

    def commanded_thrust(self, thrust: float, quaternion: Quaternion) -> float:
        """Thrust along the body z axis, 0 to 1, from these fields of ATTITUDE_TARGET. It may be NaN."""

    def command_for(self, request: AutopilotRequest, system_id: int) -> MavlinkMessage:
        """The MAVLink message of this request."""

    def parameter_value(self, message: MavlinkMessage) -> float:
        """The value in PARAM_VALUE, with integers decoded."""


MIN_RATE_HZ_OF_ALL: dict[type[Telemetry], tuple[str, float]] = {
    PositionSample: ("positions", 40.0),
    AttitudeSample: ("attitudes", 40.0),
    LandedSample: ("landed states", 2.0),
    SystemSample: ("battery states", 1.0),
    ThrustSample: ("thrusts", 5.0),  # PX4's default of 10 Hz is enough
}

# Command of a COMMAND_ACK -> requests that it may answer.
ANSWERS: dict[int, tuple[type, ...]] = {
    mavlink.MAV_CMD_DO_SET_MODE: (SetMode,),
    mavlink.MAV_CMD_COMPONENT_ARM_DISARM: (Arm, Disarm),
    mavlink.MAV_CMD_NAV_TAKEOFF: (TakeOff,),
    mavlink.MAV_CMD_REQUEST_MESSAGE: (RequestOrigin,),
}


def command_long(system_id: int, command: int, *parameters: float, param7: float = 0.0) -> MavlinkMessage:
    """COMMAND_LONG to the autopilot component. `parameters` are the first ones; those left out are zero.

    It addresses one system and component: PX4 silently ignores commands to 0/0.
    """
    padded = [float(p) for p in parameters] + [0.0] * (6 - len(parameters)) + [param7]
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


def origin_message(system_id: int, latitude_deg: float, longitude_deg: float, altitude_amsl_m: float) -> MavlinkMessage:
    """SET_GPS_GLOBAL_ORIGIN."""
    return mavlink.MAVLink_set_gps_global_origin_message(
        system_id, round(latitude_deg * 1e7), round(longitude_deg * 1e7), round(altitude_amsl_m * 1e3)
    )


def stream_request(system_id: int, message_id: int, interval_us: int) -> MavlinkMessage:
    """MAV_CMD_SET_MESSAGE_INTERVAL; interval -1 is off."""
    return command_long(system_id, mavlink.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, interval_us)
