"""What comes in: MAVLink messages -> changes of the stand-in, and its answers. One entry per message and per command."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import isfinite, sqrt

from companion.frames import Quaternion, euler_enu_from_ned, euler_from_quaternion, quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.types import Vector3
from sitl.attitude_control import Setpoint
from sitl.body_axes import flu_from_frd
from sitl.px4 import CRITICAL, Px4
from sitl.px4_link import Schedule
from sitl.px4_messages import BUILDERS
from sitl.px4_modes import Mode

M = mavlink
ACCEPTED, LATER, DENIED = M.MAV_RESULT_ACCEPTED, M.MAV_RESULT_TEMPORARILY_REJECTED, M.MAV_RESULT_DENIED
UNSUPPORTED, FAILED = M.MAV_RESULT_UNSUPPORTED, M.MAV_RESULT_FAILED
FORCE = 21196.0  # param 2 of COMPONENT_ARM_DISARM
IGNORE_RATES, IGNORE_THROTTLE, IGNORE_ATTITUDE = (0x01, 0x02, 0x04), 0x40, 0x80
CHUNK = 50  # characters of a STATUSTEXT

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
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
            "PARAM_REQUEST_LIST": self._param_list,
            "PARAM_REQUEST_READ": self._param_read,
            "PARAM_SET": self._param_set,
            "MISSION_REQUEST_LIST": self._mission_list,
            "MISSION_COUNT": self._mission_denied,
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
            M.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
        }

    def receive(self, message: MavlinkMessage) -> Answers:
        """Answers to one message. What is addressed to another system, or to nobody (0), is silently ignored."""
        handler = self._messages.get(message.get_type())
        if handler is None:
            return
        target = getattr(message, "target_system", self._px4.system_id)
        component = getattr(message, "target_component", M.MAV_COMP_ID_AUTOPILOT1)
        if message.get_type() == "SET_ATTITUDE_TARGET":
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
        yield from self._command(message, [*first, message.x / 1e7, message.y / 1e7, message.z])

    def _command(self, message: MavlinkMessage, parameters: list[float]) -> Answers:
        command = message.command
        if command in (M.MAV_CMD_REQUEST_MESSAGE, M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES):
            wanted = M.MAVLINK_MSG_ID_AUTOPILOT_VERSION
            if command == M.MAV_CMD_REQUEST_MESSAGE:
                wanted = int(parameters[0]) if isfinite(parameters[0]) else -1
            builder = BUILDERS.get(wanted)
            yield self._ack(message, ACCEPTED if builder else DENIED)
            if builder:
                yield builder(self._px4)
            return
        if command == M.MAV_CMD_GET_MESSAGE_INTERVAL and isfinite(parameters[0]):
            yield self._ack(message, ACCEPTED)
            message_id = int(parameters[0])
            yield M.MAVLink_message_interval_message(message_id, self._schedule.interval_us(message_id))
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
        """Nothing is refused: throttle ignore, a thrust that is NaN or negative and a q that is no rotation make it fall."""
        thrust = message.thrust
        falls = message.type_mask & IGNORE_THROTTLE or not isfinite(thrust) or thrust < 0.0
        thrust = 0.0 if falls else min(thrust, 1.0)
        rates = flu_from_frd(_given_rates(message))
        if not message.type_mask & IGNORE_ATTITUDE:
            quaternion = _unit(message.q)
            if quaternion is None:
                setpoint = Setpoint(self._px4.quad.estimated_quaternion(), 0.0)
            else:  # the yaw rate is a feed-forward, about the vertical
                euler = euler_enu_from_ned(*euler_from_quaternion(quaternion))
                setpoint = Setpoint(quaternion_from_euler(*euler), thrust, rates[2])
            self._px4.offboard_setpoint(setpoint)
        elif not message.type_mask & (IGNORE_RATES[0] | IGNORE_RATES[1]):
            self._px4.offboard_setpoint(Setpoint(self._px4.quad.estimated_quaternion(), thrust, rates_rad_s=rates))
        yield from ()

    def _set_origin(self, message: MavlinkMessage) -> Answers:
        self._px4.set_origin((message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3))
        yield BUILDERS[M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN](self._px4)

    def _param_list(self, _message: MavlinkMessage) -> Answers:
        yield from self._px4.parameters.messages()

    def _param_read(self, message: MavlinkMessage) -> Answers:
        name = message.param_id
        if message.param_index >= 0:
            name = self._px4.parameters.name_at(message.param_index)
        if name in self._px4.parameters.values:
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

    def _mission_denied(self, message: MavlinkMessage) -> Answers:
        yield M.MAVLink_mission_ack_message(
            message.get_srcSystem(), message.get_srcComponent(), M.MAV_MISSION_UNSUPPORTED, message.mission_type
        )

    def _mission_cleared(self, message: MavlinkMessage) -> Answers:
        yield M.MAVLink_mission_ack_message(
            message.get_srcSystem(), message.get_srcComponent(), M.MAV_MISSION_ACCEPTED, message.mission_type
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
        reply[3], reply[4], reply[5], reply[12] = 129, 1, request[3], 10  # NAK, one byte: file not found
        yield M.MAVLink_file_transfer_protocol_message(0, message.get_srcSystem(), message.get_srcComponent(), reply)

    # ------------------------------------------------------------ commands, as results in their order

    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]:
        """Answered twice: accepted at once, then what really came of it."""
        yield ACCEPTED
        try:
            mode = Mode((int(parameters[1]), int(parameters[2])))
        except (ValueError, OverflowError):
            yield DENIED
            return
        if not self._px4.set_mode(mode):
            yield LATER

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

    def _set_interval(self, parameters: list[float]) -> Iterator[int]:
        known = all(map(isfinite, parameters[:2]))
        done = known and self._schedule.set_interval(int(parameters[0]), parameters[1], self._px4.time_s)
        yield ACCEPTED if done else FAILED


def _given_rates(message: MavlinkMessage) -> Vector3:
    """Body rates FRD of a SET_ATTITUDE_TARGET; zero where they are masked or no numbers."""
    mask, rates = message.type_mask, (message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate)
    p, q, r = (
        0.0 if mask & ignored or not isfinite(rate) else rate for ignored, rate in zip(IGNORE_RATES, rates, strict=True)
    )
    return (p, q, r)


def _unit(q: Sequence[float]) -> Quaternion | None:
    """The rotation that a scaled or negated quaternion still means; None where it means none."""
    norm = sqrt(sum(part * part for part in q))
    if not isfinite(norm) or norm < 1e-6:
        return None
    w, x, y, z = q
    return (w / norm, x / norm, y / norm, z / norm)
