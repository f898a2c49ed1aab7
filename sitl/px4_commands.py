"""What comes in: MAVLink messages -> changes of the stand-in, and its answers. One entry per message and per command."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import isfinite, nan

from companion.frames import enu_from_geodetic, euler_enu_from_ned, geodetic_from_enu
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.px4 import CRITICAL, Px4
from sitl.px4_link import Schedule
from sitl.px4_messages import BUILDERS
from sitl.px4_modes import Mode
from sitl.px4_parameters import HASH_CHECK
from sitl.px4_setpoints import MAX_DISTANCE_M, course_of, setpoint_of

M = mavlink
ACCEPTED, LATER, DENIED = M.MAV_RESULT_ACCEPTED, M.MAV_RESULT_TEMPORARILY_REJECTED, M.MAV_RESULT_DENIED
UNSUPPORTED, FAILED = M.MAV_RESULT_UNSUPPORTED, M.MAV_RESULT_FAILED
FORCE = 21196.0  # param 2 of COMPONENT_ARM_DISARM
CHUNK = 50  # characters of a STATUSTEXT
NO_COORDINATE = 2**31 - 1  # COMMAND_INT's NaN
ABOVE_SEA_LEVEL = (M.MAV_FRAME_GLOBAL, M.MAV_FRAME_GLOBAL_INT)
# Commands that are REQUEST_MESSAGE by an older name.
REQUESTS_OF_ONE_MESSAGE = {
    M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: M.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    M.MAV_CMD_REQUEST_PROTOCOL_VERSION: 300,  # PROTOCOL_VERSION, which the dialect has given up: denied
    M.MAV_CMD_GET_HOME_POSITION: M.MAVLINK_MSG_ID_HOME_POSITION,
}

Answers = Iterator[MavlinkMessage]


class Receiver:
    """One link's incoming side. `receive` yields what is to be sent back on the same link."""

    def __init__(self, px4: Px4, schedule: Schedule) -> None:
        self._px4 = px4
        self._schedule = schedule
        self._text_id = 0
        self.ground_station_s: float | None = None  # when its HEARTBEAT last came on this link
        self._messages: dict[str, Callable[[MavlinkMessage], Answers]] = {
            "HEARTBEAT": self._heartbeat,
            "COMMAND_LONG": self._command_long,
            "COMMAND_INT": self._command_int,
            "SET_MODE": self._set_mode_message,
            "SET_ATTITUDE_TARGET": self._set_attitude_target,
            "SET_POSITION_TARGET_LOCAL_NED": self._set_position_target,
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_SET": self._param_set,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_COUNT": self._mission_count,
            "MISSION_REQUEST": self._no_such_item,
            "MISSION_REQUEST_INT": self._no_such_item,
            "MISSION_CLEAR_ALL": self._mission_cleared,
            "TIMESYNC": self._timesync,
            "PING": self._ping,
            "FILE_TRANSFER_PROTOCOL": self._file_transfer,
        }
        self._commands: dict[int, Callable[[list[float]], Iterator[int]]] = {
            M.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            M.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            M.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            M.MAV_CMD_NAV_LAND: lambda _p: self._to(Mode.LAND),
            M.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _p: self._to(Mode.RTL),
            M.MAV_CMD_NAV_LOITER_UNLIM: lambda _p: self._to(Mode.LOITER),
            M.MAV_CMD_DO_REPOSITION: self._reposition,
            M.MAV_CMD_MISSION_START: self._mission_start,
            M.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
        }

    def receive(self, message: MavlinkMessage) -> Answers:
        """Answers to one message. What is addressed to another system, or to nobody (0), is silently ignored."""
        handler = self._messages.get(message.get_type())
        if handler is None:
            return
        target = getattr(message, "target_system", self._px4.system_id)
        component = getattr(message, "target_component", M.MAV_COMP_ID_AUTOPILOT1)
        if message.get_type() in ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED"):
            wanted = (target, component) in ((0, 0), (self._px4.system_id, 0), (self._px4.system_id, 1))
        elif message.get_type() in ("TIMESYNC", "PING"):
            wanted = target in (0, self._px4.system_id)
        else:
            wanted = target == self._px4.system_id and component in (0, M.MAV_COMP_ID_AUTOPILOT1)
        if wanted:
            yield from handler(message)

    def texts(self, texts: list[tuple[int, str]]) -> Answers:
        """STATUSTEXT in chunks of 50 characters, the last ending in a tab."""
        for severity, text in texts:
            self._text_id = self._text_id % 65535 + 1
            whole = text + "\t"
            chunks = [whole[i : i + CHUNK] for i in range(0, len(whole), CHUNK)]
            number = self._text_id if len(chunks) > 1 else 0
            for index, chunk in enumerate(chunks):
                yield M.MAVLink_statustext_message(severity, chunk.encode(), number, index)

    # ------------------------------------------------------------ messages

    def _heartbeat(self, message: MavlinkMessage) -> Answers:
        if message.type == M.MAV_TYPE_GCS:
            self.ground_station_s = self._px4.ground_station_s = self._px4.time_s
        yield from ()

    def _command_long(self, message: MavlinkMessage) -> Answers:
        yield from self._command(message, [getattr(message, f"param{i}") for i in range(1, 8)])

    def _command_int(self, message: MavlinkMessage) -> Answers:
        first = [getattr(message, f"param{i}") for i in range(1, 5)]
        latitude, longitude = (nan if abs(x) >= NO_COORDINATE else x / 1e7 for x in (message.x, message.y))
        if message.frame in ABOVE_SEA_LEVEL:
            yield from self._command(message, [*first, latitude, longitude, message.z])
        else:
            yield self._ack(message, UNSUPPORTED)

    def _command(self, message: MavlinkMessage, parameters: list[float]) -> Answers:
        command = message.command
        number = int(parameters[0]) if isfinite(parameters[0]) and 0.0 <= parameters[0] <= 65535.0 else -1
        if command == M.MAV_CMD_REQUEST_MESSAGE or command in REQUESTS_OF_ONE_MESSAGE:
            builder = BUILDERS.get(REQUESTS_OF_ONE_MESSAGE.get(command, number))
            if builder:
                yield builder(self._px4)
            yield self._ack(message, ACCEPTED if builder else DENIED)
            return
        if command == M.MAV_CMD_GET_MESSAGE_INTERVAL and number >= 0:
            yield M.MAVLink_message_interval_message(number, self._schedule.interval_us(number))
            yield self._ack(message, ACCEPTED)
            return
        handler = self._commands.get(command)
        if handler is None:
            yield self._ack(message, UNSUPPORTED)
            return
        for result in handler(parameters):
            yield self._ack(message, result)

    def _ack(self, message: MavlinkMessage, result: int) -> MavlinkMessage:
        return M.MAVLink_command_ack_message(
            message.command, result, 255, 0, message.get_srcSystem(), message.get_srcComponent()
        )

    def _set_mode_message(self, message: MavlinkMessage) -> Answers:
        custom = message.custom_mode
        for _ in self._do_set_mode([1.0, custom >> 16 & 0xFF, custom >> 24 & 0xFF]):
            pass
        yield from ()

    def _set_attitude_target(self, message: MavlinkMessage) -> Answers:
        setpoint = setpoint_of(message, self._px4.quad.estimated_quaternion())
        if setpoint is not None:
            self._px4.offboard_setpoint(setpoint)
        yield from ()

    def _set_position_target(self, message: MavlinkMessage) -> Answers:
        course = course_of(message)
        if course is not None:
            self._px4.offboard_setpoint(course)
        yield from ()

    def _set_origin(self, message: MavlinkMessage) -> Answers:
        """Every link then tells of the new origin by itself. The stand-in's world is flat, so far ones are not taken."""
        origin = (message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
        if max(map(abs, enu_from_geodetic(*origin, self._px4.quad.world_origin))) <= MAX_DISTANCE_M:
            self._px4.set_origin(origin)
        yield from ()

    def _param_list(self, _message: MavlinkMessage) -> Answers:
        yield from self._px4.parameters.messages()

    def _param_read(self, message: MavlinkMessage) -> Answers:
        name = message.param_id
        if message.param_index >= 0:
            name = self._px4.parameters.name_at(message.param_index)
        if name == HASH_CHECK:
            yield self._px4.parameters.hash_message()
        elif name in self._px4.parameters.values:
            yield self._px4.parameters.message(name)

    def _param_set(self, message: MavlinkMessage) -> Answers:
        name = message.param_id
        self._px4.parameters.set_from_wire(name, message.param_value, message.param_type)
        if name in self._px4.parameters.values:
            yield self._px4.parameters.message(name)

    def _mission_list(self, message: MavlinkMessage) -> Answers:
        yield M.MAVLink_mission_count_message(
            message.get_srcSystem(), message.get_srcComponent(), 0, message.mission_type
        )

    def _mission_count(self, message: MavlinkMessage) -> Answers:
        """An upload: there is room for a mission of no items."""
        yield self._mission_ack(message, M.MAV_MISSION_NO_SPACE if message.count else M.MAV_MISSION_ACCEPTED)

    def _mission_cleared(self, message: MavlinkMessage) -> Answers:
        yield self._mission_ack(message, M.MAV_MISSION_ACCEPTED)

    def _no_such_item(self, message: MavlinkMessage) -> Answers:
        yield self._mission_ack(message, M.MAV_MISSION_INVALID_SEQUENCE)

    def _mission_ack(self, message: MavlinkMessage, result: int) -> MavlinkMessage:
        return M.MAVLink_mission_ack_message(
            message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
        )

    def _timesync(self, message: MavlinkMessage) -> Answers:
        if message.tc1 == 0:
            yield M.MAVLink_timesync_message(self._px4.boot_ms * 1_000_000, message.ts1)

    def _ping(self, message: MavlinkMessage) -> Answers:
        if message.target_system == 0:
            yield M.MAVLink_ping_message(
                message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
            )

    def _file_transfer(self, message: MavlinkMessage) -> Answers:
        """There are no files: NAK, so that a client goes on without them."""
        request = bytes(message.payload)
        reply = bytearray(251)
        sequence = int.from_bytes(request[:2], "little") + 1
        reply[:2] = (sequence & 0xFFFF).to_bytes(2, "little")
        reply[2] = request[2]  # the session, by which MAVProxy knows its answers
        reply[3], reply[4], reply[5], reply[12] = 129, 1, request[3], 10  # NAK, one byte: file not found
        yield M.MAVLink_file_transfer_protocol_message(0, message.get_srcSystem(), message.get_srcComponent(), reply)

    # ------------------------------------------------------------ commands, as results in their order

    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]:
        """Answered twice: accepted at once by who receives it, then by who decides, with what really came of it."""
        yield ACCEPTED
        try:
            mode = Mode((int(parameters[1]), int(parameters[2])))
        except (ValueError, OverflowError):  # no number, or no mode
            self._px4.say(CRITICAL, "Unsupported auto mode")
            yield LATER
            return
        yield ACCEPTED if self._px4.set_mode(mode) else LATER

    def _to(self, mode: Mode) -> Iterator[int]:
        yield ACCEPTED if self._px4.set_mode(mode) else LATER

    def _arm_disarm(self, parameters: list[float]) -> Iterator[int]:
        forced = parameters[1] == FORCE
        if parameters[0] == 1.0:
            refusal, word = self._px4.arm(forced), "Arming denied: "
        elif parameters[0] == 0.0:
            refusal, word = self._px4.disarm(forced), "Disarming denied: "
        else:
            yield DENIED
            return
        if refusal:
            self._px4.say(CRITICAL, word + refusal)
        yield LATER if refusal else ACCEPTED

    def _takeoff(self, parameters: list[float]) -> Iterator[int]:
        """Param 7 is above mean sea level; NaN takes MIS_TAKEOFF_ALT."""
        altitude = parameters[6]
        yield ACCEPTED if self._px4.take_off(altitude if isfinite(altitude) else None) else LATER

    def _reposition(self, parameters: list[float]) -> Iterator[int]:
        """To a latitude, a longitude and an altitude above sea level; what is no number stays as it is."""
        latitude, longitude, altitude = parameters[4:7]
        here = geodetic_from_enu(self._px4.quad.estimated_position_local_enu_m(), self._px4.quad.origin)
        goal = [new if isfinite(new) else old for new, old in zip((latitude, longitude, altitude), here, strict=True)]
        place = enu_from_geodetic(goal[0], goal[1], goal[2], self._px4.quad.origin)
        yaw_ned = parameters[3]
        yaw = euler_enu_from_ned(0.0, 0.0, yaw_ned)[2] if isfinite(yaw_ned) else None
        if max(map(abs, place)) > MAX_DISTANCE_M:
            yield DENIED
        else:
            yield ACCEPTED if self._px4.go_to(place, yaw) else LATER

    def _mission_start(self, _parameters: list[float]) -> Iterator[int]:
        self._px4.say(CRITICAL, "Mission start denied! No valid mission")
        yield LATER

    def _set_interval(self, parameters: list[float]) -> Iterator[int]:
        known = all(map(isfinite, parameters[:2]))
        done = known and self._schedule.set_interval(int(parameters[0] + 0.5), parameters[1], self._px4.time_s)
        yield ACCEPTED if done else FAILED
