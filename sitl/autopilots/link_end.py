"""A stand-in's end of one MAVLink link: bytes in, bytes out, message rates. No sockets, no clocks.

`Receiver` handles the incoming messages that all autopilot types handle alike; that of each type adds its own messages and
commands, one entry each.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain
from math import inf, isfinite, nan
from typing import Any, ClassVar

from companion.geometry.frames import enu_from_geodetic, euler_enu_from_ned, flu_from_frd
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.values import Vector3
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.external_vision import Pose, pose_of, pose_of_odometry
from sitl.autopilots.logs import Answers, Handler, LogTransfer
from sitl.autopilots.messages import BUILDERS
from sitl.autopilots.parameters import AutopilotData
from sitl.vehicle.automatic_flight import Course
from sitl.vehicle.control import AttitudeSetpoint

M = mavlink
ACCEPTED, LATER, DENIED = M.MAV_RESULT_ACCEPTED, M.MAV_RESULT_TEMPORARILY_REJECTED, M.MAV_RESULT_DENIED
UNSUPPORTED, FAILED = M.MAV_RESULT_UNSUPPORTED, M.MAV_RESULT_FAILED
FORCE = 21196.0  # param 2 of COMPONENT_ARM_DISARM
IGNORE_RATES = (0x01, 0x02, 0x04)  # of type_mask of SET_ATTITUDE_TARGET: roll, pitch, yaw
IGNORE_THROTTLE, IGNORE_ATTITUDE = 0x40, 0x80
IGNORE_POSITION, IGNORE_VELOCITY = (0x01, 0x02, 0x04), (0x08, 0x10, 0x20)  # of SET_POSITION_TARGET_LOCAL_NED: x, y, z
IGNORE_YAW, IGNORE_YAW_RATE = 0x400, 0x800
CHUNK = 50  # characters of a STATUSTEXT
MAX_DISTANCE_M = 10_000.0
NO_COORDINATE = 2**31 - 1  # COMMAND_INT's NaN
# Older commands for REQUEST_MESSAGE.
REQUESTS_OF_ONE_MESSAGE = {
    M.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES: M.MAVLINK_MSG_ID_AUTOPILOT_VERSION,
    M.MAV_CMD_REQUEST_PROTOCOL_VERSION: 300,  # PROTOCOL_VERSION, no longer in the dialect: denied
    M.MAV_CMD_GET_HOME_POSITION: M.MAVLINK_MSG_ID_HOME_POSITION,
}

EPSILON_S = 1e-6


class Receiver(ABC):
    """Incoming messages of one link. `receive` yields the answers on the same link.

    `_on_heartbeat` handles HEARTBEAT, and so on. A receiver without such a method ignores the message.
    """

    logs: LogTransfer
    UNKNOWN_MESSAGE: ClassVar[int]  # MAV_RESULT of a request for it
    NO_DATA: ClassVar[int] = ACCEPTED  # and for one that is known, of which there is none yet
    TEXT_ENDS_WITH: ClassVar[str] = ""

    def __init__(self, autopilot: Autopilot, schedule: Schedule) -> None:
        """The receiver of a type adds its log transfer and its commands."""
        self._autopilot = autopilot
        self._schedule = schedule
        self._text_id = 0
        self.ground_station_s: float | None = None  # when its HEARTBEAT last came on this link
        self._commands: dict[int, Callable[[list[float]], Iterator[int]]] = {  # results in their order
            M.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            M.MAV_CMD_NAV_LAND: lambda _p: self._enter_mode("LAND"),
            M.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _p: self._enter_mode("RTL"),
            M.MAV_CMD_NAV_LOITER_UNLIM: lambda _p: self._enter_mode("LOITER"),
        }

    def receive(self, message: MavlinkMessage) -> Answers:
        """Answers to one message, by the method with its name. Messages for other targets are ignored silently."""
        name = message.get_type()
        handler: Handler | None = self.logs.requests.get(name) or getattr(self, f"_on_{name.lower()}", None)
        if handler is not None and self._is_for_it(message):
            yield from handler(message) or ()

    def texts(self, texts: list[tuple[int, str]]) -> Answers:
        """STATUSTEXT in chunks of 50 characters."""
        for severity, text in texts:
            self._text_id = self._text_id % 65535 + 1
            whole = text + self.TEXT_ENDS_WITH
            chunks = [whole[i : i + CHUNK] for i in range(0, len(whole), CHUNK)]
            number = self._text_id if len(chunks) > 1 else 0
            for index, chunk in enumerate(chunks):
                yield M.MAVLink_statustext_message(severity, chunk.encode(), number, index)

    @abstractmethod
    def _is_for_it(self, message: MavlinkMessage) -> bool:
        """Whether this autopilot accepts the message's target."""

    # ------------------------------------------------------------ messages

    def _on_heartbeat(self, message: MavlinkMessage) -> None:
        if self._is_of_ground_station(message):
            self.ground_station_s = self._autopilot.ground_station_s = self._autopilot.time_s

    @abstractmethod
    def _is_of_ground_station(self, heartbeat: MavlinkMessage) -> bool: ...

    def _on_command_long(self, message: MavlinkMessage) -> Answers:
        yield from self._command(message, [getattr(message, f"param{i}") for i in range(1, 8)])

    def _command(self, message: MavlinkMessage, parameters: list[float]) -> Answers:
        command = message.command
        number = int(parameters[0]) if isfinite(parameters[0]) and 0.0 <= parameters[0] <= 65535.0 else -1
        if command == M.MAV_CMD_REQUEST_MESSAGE or command in REQUESTS_OF_ONE_MESSAGE:
            message_id = REQUESTS_OF_ONE_MESSAGE.get(command, number)
            known = message_id in self._autopilot.data.message_ids
            reply = BUILDERS[message_id](self._autopilot) if known else None
            if reply is not None:
                yield reply
            result = self.UNKNOWN_MESSAGE if not known else self.NO_DATA if reply is None else ACCEPTED
            yield self._ack(message, result)
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

    def _on_set_mode(self, message: MavlinkMessage) -> None:
        """SET_MODE is not answered."""
        for _ in self._do_set_mode([1.0, *self._mode_parameters(message.custom_mode)]):
            pass

    def _take_setpoint(self, message: MavlinkMessage) -> None:
        if not self._autopilot.follows_setpoints:
            return
        is_attitude = message.get_type() == "SET_ATTITUDE_TARGET"
        setpoint = self._attitude_of(message) if is_attitude else self._course_of(message)
        if setpoint is None:
            self._autopilot.stop()
        else:
            self._autopilot.take_setpoint(setpoint)

    _on_set_attitude_target = _on_set_position_target_local_ned = _take_setpoint

    @abstractmethod
    def _attitude_of(self, message: MavlinkMessage) -> AttitudeSetpoint | None:
        """The setpoint of a SET_ATTITUDE_TARGET; None without one that can be followed."""

    @abstractmethod
    def _course_of(self, message: MavlinkMessage) -> Course | None:
        """The course of a SET_POSITION_TARGET_LOCAL_NED; None without one that can be followed."""

    @abstractmethod
    def _mode_parameters(self, custom_mode: int) -> tuple[float, ...]:
        """The parameters of DO_SET_MODE, from the second on, for this custom_mode."""

    # ------------------------------------------------------------ commands

    @abstractmethod
    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]: ...

    @abstractmethod
    def _enter_mode(self, name: str) -> Iterator[int]:
        """Enter the mode with this name, if the autopilot allows it."""

    def _ack(self, message: MavlinkMessage, result: int) -> MavlinkMessage:
        return M.MAVLink_command_ack_message(
            message.command, result, 255, 0, message.get_srcSystem(), message.get_srcComponent()
        )

    def _on_param_request_list(self, _message: MavlinkMessage) -> Answers:
        yield from self._autopilot.parameters.messages()

    def _on_param_request_read(self, message: MavlinkMessage) -> Answers:
        name = message.param_id
        if message.param_index >= 0:
            name = self._autopilot.parameters.name_at(message.param_index)
        reply = self._autopilot.parameters.read(name) if name else None
        if reply:
            yield reply

    def _on_param_set(self, message: MavlinkMessage) -> Answers:
        name = message.param_id
        self._autopilot.parameters.set_from_wire(name, message.param_value, message.param_type)
        if name in self._autopilot.parameters.values:
            yield self._autopilot.parameters.message(name)

    def _on_mission_request_list(self, message: MavlinkMessage) -> Answers:
        rally = message.mission_type == M.MAV_MISSION_TYPE_RALLY
        number = len(self._autopilot.rally_points) if rally else 0
        yield M.MAVLink_mission_count_message(
            message.get_srcSystem(), message.get_srcComponent(), number, message.mission_type
        )

    def _on_mission_count(self, message: MavlinkMessage) -> Answers:
        """An upload: only an empty mission is accepted."""
        yield self._mission_ack(message, M.MAV_MISSION_NO_SPACE if message.count else M.MAV_MISSION_ACCEPTED)

    def _on_mission_clear_all(self, message: MavlinkMessage) -> Answers:
        yield self._mission_ack(message, M.MAV_MISSION_ACCEPTED)

    def _on_mission_request(self, message: MavlinkMessage) -> Answers:
        yield self._mission_ack(message, M.MAV_MISSION_INVALID_SEQUENCE)

    _on_mission_request_int = _on_mission_request

    def _mission_ack(self, message: MavlinkMessage, result: int) -> MavlinkMessage:
        return M.MAVLink_mission_ack_message(
            message.get_srcSystem(), message.get_srcComponent(), result, message.mission_type
        )

    def _on_vision_position_estimate(self, message: MavlinkMessage) -> None:
        self._take_pose(pose_of(message, message.usec, message.yaw))

    def _on_odometry(self, message: MavlinkMessage) -> None:
        if self._autopilot.data.external_vision.takes(message):
            self._take_pose(pose_of_odometry(message))

    def _take_pose(self, pose: Pose | None) -> None:
        if pose is not None:
            self._autopilot.take_pose(pose)

    def _on_timesync(self, message: MavlinkMessage) -> Answers:
        if message.tc1 == 0:
            yield M.MAVLink_timesync_message(self._autopilot.boot_ms * 1_000_000, message.ts1)


def origin_of(message: MavlinkMessage, autopilot: Autopilot) -> Vector3 | None:
    """The origin of a SET_GPS_GLOBAL_ORIGIN. The stand-in's world is flat, so there are no distant ones."""
    origin = (message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
    away_m = max(map(abs, enu_from_geodetic(*origin, autopilot.quad.world_origin)))
    return origin if away_m <= MAX_DISTANCE_M else None


def turn_of(message: MavlinkMessage) -> tuple[float, float]:
    """Yaw [rad] and yaw rate [rad/s] in ENU of a SET_POSITION_TARGET_LOCAL_NED; NaN and 0 for those that it does not give."""
    mask = message.type_mask
    yaw_rad = nan if mask & IGNORE_YAW else euler_enu_from_ned(0.0, 0.0, message.yaw)[2]
    return yaw_rad, 0.0 if mask & IGNORE_YAW_RATE else flu_from_frd((0.0, 0.0, message.yaw_rate))[2]


class Schedule:
    """Rates of one link. They persist when the peer reconnects."""

    def __init__(self, rates_hz: dict[int, float]) -> None:
        self.reset(rates_hz, 0.0)

    def reset(self, rates_hz: dict[int, float], now_s: float) -> None:
        """Set other default rates: PX4's ground link sends more after its peer has connected."""
        self._defaults = rates_hz
        self._period_s = {message_id: 1.0 / rate_hz for message_id, rate_hz in rates_hz.items() if rate_hz > 0.0}
        self._due_s = dict.fromkeys(self._period_s, now_s)
        self.next_s = now_s - EPSILON_S  # before it nothing is due

    def set_rate(self, message_id: int, rate_hz: float, now_s: float) -> None:
        """Set a rate; the first message is due one period from now. 0 is off."""
        self._due_s.pop(message_id, None)
        self._period_s.pop(message_id, None)
        if rate_hz > 0.0:
            self._period_s[message_id] = 1.0 / rate_hz
            self._due_s[message_id] = now_s + self._period_s[message_id]
        self.next_s = min(self._due_s.values(), default=inf) - EPSILON_S

    def postpone(self, message_id: int) -> None:
        """Skip a message that is due; it is due again one period later."""
        self._due_s[message_id] += self._period_s[message_id]

    def default_hz(self, message_id: int) -> float:
        return self._defaults.get(message_id, 0.0)

    def interval_us(self, message_id: int) -> int:
        """Interval as in MESSAGE_INTERVAL: -1 is off."""
        return round(self._period_s[message_id] * 1e6) if message_id in self._period_s else -1

    def due(self, now_s: float) -> list[int]:
        """Messages to be sent now. They are evenly spaced: a late step does not shift the following ones."""
        if now_s < self.next_s:
            return []
        ready = [message_id for message_id, due_s in self._due_s.items() if now_s >= due_s - EPSILON_S]
        ready = self._without_old_news(ready)
        for message_id in ready:
            period_s = self._period_s[message_id]
            next_s = self._due_s[message_id] + period_s
            self._due_s[message_id] = next_s if next_s > now_s else now_s + period_s
        self.next_s = min(self._due_s.values(), default=inf) - EPSILON_S
        return ready

    def _without_old_news(self, ready: list[int]) -> list[int]:
        """The due messages that are sent; the others remain due."""
        return ready


class LinkEnd:
    """One link. Messages are due by the autopilot's clock."""

    ON_CHANGE: ClassVar[tuple[int, ...]] = (M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN,)  # sent whenever the origin changes

    def __init__(self, autopilot: Autopilot, schedule: Schedule, receiver: Receiver, codec: MavlinkCodec) -> None:
        self._autopilot = autopilot
        self._codec = codec
        self._origin_sent: int | None = None  # the number of the change
        self.sends_changes = True
        self.schedule = schedule
        self.receiver = receiver

    @property
    def system_id(self) -> int:
        """Of the autopilot."""
        return self._autopilot.system_id

    def receive(self, data: bytes) -> Iterator[bytes]:
        """Answers to received bytes."""
        for message in self._codec_now().decode(data):
            yield from self._encoded(self.receiver.receive(message))

    def due(self) -> Iterator[bytes]:
        """All packets that are due now."""
        yield from self.texts()
        telemetry = self._built(self.schedule.due(self._autopilot.time_s))
        yield from self._encoded(chain(self._changes(), telemetry, self.receiver.logs.due()))

    def texts(self) -> Iterator[bytes]:
        """STATUSTEXT of the autopilot's texts, if this link sends them."""
        if self._autopilot.texts and self._sends_texts():
            yield from self._encoded(self.receiver.texts(self._autopilot.texts))

    @property
    def has_changes(self) -> bool:
        """Whether `changes` yields something."""
        return self.sends_changes and self._origin_sent != self._autopilot.origin_changes

    def changes(self) -> Iterator[bytes]:
        """Messages that are sent on change, independently of the rates."""
        yield from self._encoded(self._changes())

    def peer_connected(self) -> None:
        """The first packet of a peer has come."""

    def _sends_texts(self) -> bool:
        return True

    def _changes(self) -> Iterator[MavlinkMessage]:
        if self.has_changes:
            self._origin_sent = self._autopilot.origin_changes
            yield from self._built(self.ON_CHANGE)

    def _built(self, message_ids: Iterable[int]) -> Iterator[MavlinkMessage]:
        for message_id in message_ids:
            message = BUILDERS[message_id](self._autopilot)
            if message is not None:
                yield message

    def _codec_now(self) -> MavlinkCodec:
        """The codec of the present signing."""
        return self._codec

    def _encoded(self, messages: Iterable[MavlinkMessage]) -> Iterator[bytes]:
        for message in messages:
            yield self._codec_now().encode(message)


@dataclass(frozen=True, slots=True)
class AutopilotType:
    """An autopilot type: its vehicle, and the ends of its links; `tcp_link` is None for one that does not listen on TCP."""

    vehicle: type[Autopilot]
    onboard_link: Callable[[Any], LinkEnd]  # each takes a vehicle of this type
    ground_link: Callable[[Any], LinkEnd]
    tcp_link: Callable[[Any], LinkEnd] | None = None

    @property
    def data(self) -> AutopilotData:
        return self.vehicle.data
