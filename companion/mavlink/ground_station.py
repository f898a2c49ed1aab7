"""Filter for MAVLink packets from a ground station to the autopilot. No sockets, no clocks.

The ground station uses its own system id. Only the agent may send setpoints and set the rates of the telemetry that it needs.
While the agent has the vehicle, only the packets listed here pass: the pilot's sticks and changes of mode, which end the
agent's command, and what moves nothing. In particular DO_REPOSITION moves an ArduCopter without a change of its mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Set

from companion.mavlink.codec import MavlinkMessage, PacketReader, mavlink
from companion.types.flight import FLYING, FlightPhase
from companion.types.notices import Code

SETPOINTS = {
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET,
}
# Groups of REQUEST_DATA_STREAM that contain positions or attitudes; QGroundControl requests them from ArduPilot at 3 Hz.
SHARED_GROUPS = {mavlink.MAV_DATA_STREAM_ALL, mavlink.MAV_DATA_STREAM_POSITION, mavlink.MAV_DATA_STREAM_EXTRA1}
COMMANDS = (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)

# The phases in which the agent has the vehicle. Before arming and while it observes, the operator may configure the autopilot.
AGENT_FLIES = FLYING | {FlightPhase.ARM, FlightPhase.ARMED}

MESSAGES_IN_FLIGHT = frozenset(
    {
        mavlink.MAVLINK_MSG_ID_HEARTBEAT,
        mavlink.MAVLINK_MSG_ID_PING,
        mavlink.MAVLINK_MSG_ID_SYSTEM_TIME,
        mavlink.MAVLINK_MSG_ID_TIMESYNC,
        mavlink.MAVLINK_MSG_ID_COMMAND_ACK,
        mavlink.MAVLINK_MSG_ID_RADIO_STATUS,
        # The pilot
        mavlink.MAVLINK_MSG_ID_SET_MODE,
        mavlink.MAVLINK_MSG_ID_MANUAL_CONTROL,
        mavlink.MAVLINK_MSG_ID_RC_CHANNELS_OVERRIDE,
        # Corrections and positions that the estimator must not miss in flight
        mavlink.MAVLINK_MSG_ID_GPS_RTCM_DATA,
        mavlink.MAVLINK_MSG_ID_VISION_POSITION_ESTIMATE,
        mavlink.MAVLINK_MSG_ID_ATT_POS_MOCAP,
        # Reading
        mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_PARAM_REQUEST_READ,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_LIST,
        mavlink.MAVLINK_MSG_ID_MISSION_REQUEST_INT,
        mavlink.MAVLINK_MSG_ID_MISSION_ACK,
        # Remote identification by law
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_BASIC_ID,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SYSTEM_UPDATE,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_OPERATOR_ID,
        mavlink.MAVLINK_MSG_ID_OPEN_DRONE_ID_SELF_ID,
    }
)
COMMANDS_IN_FLIGHT = frozenset(
    {
        # Changes of mode: the agent observes from then on
        mavlink.MAV_CMD_DO_SET_MODE,
        mavlink.MAV_CMD_NAV_LAND,
        mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH,
        mavlink.MAV_CMD_NAV_LOITER_UNLIM,
        # Emergencies
        mavlink.MAV_CMD_DO_FLIGHTTERMINATION,
        mavlink.MAV_CMD_DO_PARACHUTE,
        # Reading
        mavlink.MAV_CMD_REQUEST_MESSAGE,
        mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_GET_MESSAGE_INTERVAL,
        mavlink.MAV_CMD_GET_HOME_POSITION,
        mavlink.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES,
        # Camera and gimbal
        mavlink.MAV_CMD_IMAGE_START_CAPTURE,
        mavlink.MAV_CMD_IMAGE_STOP_CAPTURE,
        mavlink.MAV_CMD_VIDEO_START_CAPTURE,
        mavlink.MAV_CMD_VIDEO_STOP_CAPTURE,
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_PITCHYAW,
        mavlink.MAV_CMD_DO_GIMBAL_MANAGER_CONFIGURE,
    }
)


class GroundStationFilter:
    """Datagrams of a ground station -> permitted packets for vehicle `vehicle_id`, unchanged.

    `refused` counts refused packets by code.
    """

    def __init__(self, vehicle_id: int, own_streams: Set[int]) -> None:
        """`own_streams`: ids of the messages whose rate only the agent may set."""
        self._vehicle_id = vehicle_id
        self._own_streams = own_streams
        self.refused: Counter[str] = Counter()

    def admit(self, datagram: bytes, phase: FlightPhase) -> list[bytes]:
        """The packets of a datagram that are permitted in this phase. Never raises.

        Packets to other vehicles are left out without counting: many ground stations send every packet to all vehicles.
        """
        reader = PacketReader()  # a new one: an incomplete packet must not consume the next datagram
        admitted = []
        for packet in reader.read(datagram):
            message = packet.message
            code = self._refusal(message, phase)
            if getattr(message, "target_system", 0) not in (0, self._vehicle_id):
                continue
            if code:
                self.refused[code] += 1
            else:
                admitted.append(packet.data)
        unreadable = reader.refused.total() + (not reader.is_between_packets)
        if unreadable:
            self.refused[Code.GROUND_STATION_UNREADABLE] += unreadable
        return admitted

    def _refusal(self, message: MavlinkMessage, phase: FlightPhase) -> Code | None:
        message_id = message.get_msgId()
        if message_id == mavlink.MAVLINK_MSG_ID_UNKNOWN:
            return Code.GROUND_STATION_UNREADABLE
        if message.get_srcSystem() == self._vehicle_id:
            return Code.GROUND_STATION_OWN_ID
        if message_id in SETPOINTS:
            return Code.GROUND_STATION_SETPOINT
        if self._sets_own_rate(message):
            return Code.GROUND_STATION_RATE
        if phase in AGENT_FLIES and not _permitted_in_flight(message):
            return Code.GROUND_STATION_IN_FLIGHT
        return None

    def _sets_own_rate(self, message: MavlinkMessage) -> bool:
        if message.get_msgId() == mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM:
            return message.req_stream_id in SHARED_GROUPS
        is_interval = message.get_msgId() in COMMANDS and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
        return is_interval and message.param1 in self._own_streams


def _permitted_in_flight(message: MavlinkMessage) -> bool:
    if message.get_msgId() not in COMMANDS:
        return message.get_msgId() in MESSAGES_IN_FLIGHT
    if message.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
        return bool(message.param1 == 0.0)  # an emergency stop
    return message.command in COMMANDS_IN_FLIGHT
