"""What of a ground station's MAVLink may go to the autopilot beside the agent's own. No sockets, no clocks.

The ground station speaks with its own system id and commands as ever: modes, missions, parameters, its heartbeat. Setpoints
and the telemetry that the agent lives on are the agent's alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Set

from companion.mavlink.codec import UNREADABLE, MavlinkMessage, mavlink

SETPOINTS = {
    mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_LOCAL_NED,
    mavlink.MAVLINK_MSG_ID_SET_POSITION_TARGET_GLOBAL_INT,
    mavlink.MAVLINK_MSG_ID_SET_ACTUATOR_CONTROL_TARGET,
}
# REQUEST_DATA_STREAM's groups with positions and attitudes in them; QGroundControl asks ArduPilot for 3 Hz of them.
SHARED_GROUPS = {mavlink.MAV_DATA_STREAM_ALL, mavlink.MAV_DATA_STREAM_POSITION, mavlink.MAV_DATA_STREAM_EXTRA1}

ITS_VOICE = "ground station: a packet under this vehicle's own id"
ITS_SETPOINT = "ground station: a setpoint; change the mode first"
ITS_RATE = "ground station: another rate for telemetry that the agent needs"
UNREADABLE_FROM_IT = f"ground station: {UNREADABLE}"


class GroundStationFilter:
    """Datagrams of a ground station -> the packets for vehicle `vehicle_id`, as they came. What is refused is counted."""

    def __init__(self, vehicle_id: int, own_streams: Set[int]) -> None:
        """`own_streams`: ids of the messages whose rate is the agent's to choose."""
        self._vehicle_id = vehicle_id
        self._own_streams = own_streams
        self.refused: Counter[str] = Counter()

    def admit(self, datagram: bytes) -> list[bytes]:
        """Never raises. Packets to other vehicles are left out without a word: many ground stations send all to all."""
        parser = mavlink.MAVLink(None)  # a new one: half a packet must not swallow the beginning of the next datagram
        parser.robust_parsing = True
        admitted = []
        for message in parser.parse_buffer(datagram) or []:
            reason = self._refusal(message)
            if reason:
                self.refused[reason] += 1
            elif getattr(message, "target_system", 0) in (0, self._vehicle_id):
                admitted.append(bytes(message.get_msgbuf()))
        if parser.buf_len():
            self.refused[UNREADABLE_FROM_IT] += 1
        return admitted

    def _refusal(self, message: MavlinkMessage) -> str | None:
        message_id = message.get_msgId()
        if message_id in (mavlink.MAVLINK_MSG_ID_BAD_DATA, mavlink.MAVLINK_MSG_ID_UNKNOWN):
            return UNREADABLE_FROM_IT
        if message.get_srcSystem() == self._vehicle_id:
            return ITS_VOICE
        if message_id in SETPOINTS:
            return ITS_SETPOINT
        if message_id == mavlink.MAVLINK_MSG_ID_REQUEST_DATA_STREAM:
            return ITS_RATE if message.req_stream_id in SHARED_GROUPS else None
        is_command = message_id in (mavlink.MAVLINK_MSG_ID_COMMAND_LONG, mavlink.MAVLINK_MSG_ID_COMMAND_INT)
        if (
            is_command
            and message.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
            and message.param1 in self._own_streams
        ):
            return ITS_RATE
        return None
