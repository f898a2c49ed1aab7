"""Filter for MAVLink packets from a ground station to the autopilot. No sockets, no clocks.

The ground station uses its own system id. Only the agent may send setpoints and set the rates of the telemetry that it needs.
While the agent has the vehicle, only the packets listed here pass: the pilot's sticks and changes of mode, which end the
agent's command, and what moves nothing. In particular DO_REPOSITION moves an ArduCopter without a change of its mode.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Set

from companion.mavlink.codec import MavlinkMessage, PacketReader, mavlink, named
from companion.types.flight import FLYING, FlightPhase
from companion.types.notices import Code

SETPOINTS = named(
    "MAVLINK_MSG_ID",
    "SET_ATTITUDE_TARGET SET_POSITION_TARGET_LOCAL_NED SET_POSITION_TARGET_GLOBAL_INT SET_ACTUATOR_CONTROL_TARGET",
)
# Groups of REQUEST_DATA_STREAM that contain positions or attitudes; QGroundControl requests them from ArduPilot at 3 Hz.
SHARED_GROUPS = named("MAV_DATA_STREAM", "ALL POSITION EXTRA1")
COMMANDS = named("MAVLINK_MSG_ID", "COMMAND_LONG COMMAND_INT")

# The phases in which the agent has the vehicle. Before arming and while it observes, the operator may configure the autopilot.
AGENT_FLIES = FLYING | {FlightPhase.ARM, FlightPhase.ARMED}

MESSAGES_IN_FLIGHT = named(
    "MAVLINK_MSG_ID",
    "HEARTBEAT PING SYSTEM_TIME TIMESYNC COMMAND_ACK RADIO_STATUS",
    # The pilot
    "SET_MODE MANUAL_CONTROL RC_CHANNELS_OVERRIDE",
    # Measurements and corrections: what the estimator or the landing used before arming, it must not miss in flight
    "GPS_RTCM_DATA GPS_INJECT_DATA GPS_INPUT VISION_POSITION_ESTIMATE VISION_SPEED_ESTIMATE VICON_POSITION_ESTIMATE",
    "GLOBAL_VISION_POSITION_ESTIMATE ATT_POS_MOCAP ODOMETRY OPTICAL_FLOW OPTICAL_FLOW_RAD DISTANCE_SENSOR",
    "OBSTACLE_DISTANCE WHEEL_DISTANCE AIRSPEED TERRAIN_DATA LANDING_TARGET",
    # Reading
    "REQUEST_DATA_STREAM PARAM_REQUEST_LIST PARAM_REQUEST_READ MISSION_REQUEST_LIST MISSION_REQUEST_INT MISSION_ACK",
    # Remote identification by law
    "OPEN_DRONE_ID_BASIC_ID OPEN_DRONE_ID_SYSTEM OPEN_DRONE_ID_SYSTEM_UPDATE OPEN_DRONE_ID_OPERATOR_ID OPEN_DRONE_ID_SELF_ID",
)
COMMANDS_IN_FLIGHT = named(
    "MAV_CMD",
    # Changes of mode: the agent observes from then on
    "DO_SET_MODE NAV_LAND NAV_RETURN_TO_LAUNCH NAV_LOITER_UNLIM",
    # Emergencies
    "DO_FLIGHTTERMINATION DO_PARACHUTE",
    # Reading
    "REQUEST_MESSAGE SET_MESSAGE_INTERVAL GET_MESSAGE_INTERVAL GET_HOME_POSITION REQUEST_AUTOPILOT_CAPABILITIES",
    # Camera and gimbal
    "IMAGE_START_CAPTURE IMAGE_STOP_CAPTURE VIDEO_START_CAPTURE VIDEO_STOP_CAPTURE",
    "DO_GIMBAL_MANAGER_PITCHYAW DO_GIMBAL_MANAGER_CONFIGURE",
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
