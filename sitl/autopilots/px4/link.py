"""PX4's end of a link: setpoints, commands with their double answers, message rates."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from math import inf, isfinite, nan, sqrt
from sys import float_info

from companion.geometry.frames import (
    Quaternion,
    enu_from_geodetic,
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    flu_from_frd,
    quaternion_from_euler,
)
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.values import Vector3
from sitl.autopilots.autopilot import CRITICAL
from sitl.autopilots.link_end import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    IGNORE_ATTITUDE,
    IGNORE_POSITION,
    IGNORE_RATES,
    IGNORE_THROTTLE,
    IGNORE_VELOCITY,
    LATER,
    MAX_DISTANCE_M,
    NO_COORDINATE,
    UNSUPPORTED,
    AutopilotType,
    LinkEnd,
    Receiver,
    Schedule,
    origin_of,
    turn_of,
)
from sitl.autopilots.logs import Answers
from sitl.autopilots.parameters import message_ids, rates_by_id
from sitl.autopilots.px4.autopilot import Px4, Px4Mode
from sitl.autopilots.px4.logs import Px4LogTransfer
from sitl.vehicle.automatic_flight import Course
from sitl.vehicle.control import AttitudeSetpoint

GROUND_STATION_LOST_S = 5.0
MAX_RATE_HZ = 125.0  # 500 Hz is accepted and gives 125
STATUS_PERIOD_S = 0.51  # of CURRENT_MODE while nothing changes, whatever the interval

DATA = Px4.data
ONBOARD_RATES_HZ = rates_by_id(DATA.onboard_rates_hz)
GROUND_RATES_HZ = rates_by_id(DATA.ground_rates_hz)  # once its peer has connected
HEARTBEAT_ONLY = {mavlink.MAVLINK_MSG_ID_HEARTBEAT: 1.0}
SILENT = frozenset(message_ids(DATA.silent))
FIXED = {mavlink.MAVLINK_MSG_ID_HEARTBEAT, mavlink.MAVLINK_MSG_ID_MISSION_CURRENT}  # their rates cannot be set
SETTABLE = (frozenset(ONBOARD_RATES_HZ) | SILENT) - FIXED
BODY_RATES = ("body_roll_rate", "body_pitch_rate", "body_yaw_rate")
ABOVE_SEA_LEVEL = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)


def setpoint_of(message: MavlinkMessage, attitude: Quaternion) -> AttitudeSetpoint | None:
    """The setpoint, None for a message without one; `attitude` is the present attitude.

    Nothing is rejected: throttle ignore, NaN or negative thrust, and a q that is not a rotation make the vehicle fall.
    """
    thrust = message.thrust
    falls = message.type_mask & IGNORE_THROTTLE or not isfinite(thrust) or thrust < 0.0
    thrust = 0.0 if falls else min(thrust, 1.0)
    rates = flu_from_frd(_given(message, BODY_RATES, IGNORE_RATES, float_info.max, 0.0))
    if message.type_mask & IGNORE_ATTITUDE:
        if message.type_mask & (IGNORE_RATES[0] | IGNORE_RATES[1]):
            return None
        return AttitudeSetpoint(attitude, thrust, rates_rad_s=rates)
    quaternion = _unit(message.q)
    if quaternion is None:
        return AttitudeSetpoint(attitude, 0.0)
    euler = euler_enu_from_ned(*euler_from_quaternion(quaternion))
    return AttitudeSetpoint(
        quaternion_from_euler(*euler), thrust, yaw_rate_rad_s=rates[2]
    )  # fed forward, about the vertical


def _given(
    message: MavlinkMessage, names: Sequence[str], ignored: Sequence[int], most: float, default: float
) -> Vector3:
    """Three fields of a setpoint; `default` for one that is masked, larger than `most` or not finite."""
    fields = zip((getattr(message, name) for name in names), ignored, strict=True)
    x, y, z = (default if message.type_mask & bit or not abs(value) <= most else value for value, bit in fields)
    return (x, y, z)


def _unit(q: Sequence[float]) -> Quaternion | None:
    """The rotation of a scaled or negated quaternion; None for one that is not a rotation."""
    norm = sqrt(sum(part * part for part in q))
    if not isfinite(norm) or norm < 1e-6:
        return None
    w, x, y, z = q
    return (w / norm, x / norm, y / norm, z / norm)


class Px4Schedule(Schedule):
    """PX4's rates: which intervals can be set, and which messages are sent only on change."""

    def __init__(self, px4: Px4, rates_hz: dict[int, float]) -> None:
        super().__init__(rates_hz)
        self._px4 = px4
        self._setpoint_sent: object = None
        self._status_sent: object = None
        self._status_sent_s = -inf

    def set_interval(self, message_id: int, interval_us: float, now_s: float) -> bool:
        """MAV_CMD_SET_MESSAGE_INTERVAL: 0 is the default, -1 off. False if it cannot be changed."""
        if message_id not in SETTABLE:
            return False
        if message_id not in SILENT:
            rate_hz = self.default_hz(message_id) if interval_us == 0.0 else 1e6 / interval_us
            self.set_rate(message_id, min(rate_hz, MAX_RATE_HZ), now_s)
        return True

    def _without_old_news(self, ready: list[int]) -> list[int]:
        if mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET in ready and not self._setpoint_is_new():
            ready.remove(mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET)
        if mavlink.MAVLINK_MSG_ID_CURRENT_MODE in ready and not self._mode_is_due():
            ready.remove(mavlink.MAVLINK_MSG_ID_CURRENT_MODE)
            self.postpone(mavlink.MAVLINK_MSG_ID_CURRENT_MODE)
        return ready

    def _setpoint_is_new(self) -> bool:
        """The echo waits for a new setpoint, then is sent at once. Disarmed it is sent at its rate."""
        before, self._setpoint_sent = self._setpoint_sent, self._px4.setpoint if self._px4.armed else None
        return self._setpoint_sent is None or self._setpoint_sent is not before

    def _mode_is_due(self) -> bool:
        """Only when the vehicle's status has changed, or after 0.51 to 0.53 s, as measured."""
        px4 = self._px4
        status = (px4.mode, px4.intended_mode, px4.armed, px4.failsafe)
        if status == self._status_sent and px4.time_s - self._status_sent_s < STATUS_PERIOD_S:
            return False
        self._status_sent, self._status_sent_s = status, px4.time_s
        return True


class Px4Receiver(Receiver):
    """Incoming messages of one link."""

    UNKNOWN_MESSAGE = NO_DATA = DENIED
    TEXT_ENDS_WITH = "\t"
    _schedule: Px4Schedule

    def __init__(self, px4: Px4, schedule: Px4Schedule) -> None:
        super().__init__(px4, schedule)
        self._px4 = px4
        self.logs = Px4LogTransfer(px4)
        self._commands |= {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_MISSION_START: self._mission_start,
        }

    def _is_for_it(self, message: MavlinkMessage) -> bool:
        """Commands to target 0 are ignored silently. Log requests are accepted for every target."""
        if message.get_type() in self.logs.requests:
            return True
        target = getattr(message, "target_system", self._px4.system_id)
        component = getattr(message, "target_component", mavlink.MAV_COMP_ID_AUTOPILOT1)
        if message.get_type() in ("SET_ATTITUDE_TARGET", "SET_POSITION_TARGET_LOCAL_NED"):
            return (target, component) in ((0, 0), (self._px4.system_id, 0), (self._px4.system_id, 1))
        if message.get_type() in ("TIMESYNC", "PING"):
            return target in (0, self._px4.system_id)
        return target == self._px4.system_id and component in (0, mavlink.MAV_COMP_ID_AUTOPILOT1)

    # ------------------------------------------------------------ messages

    def _is_of_ground_station(self, heartbeat: MavlinkMessage) -> bool:
        return bool(heartbeat.type == mavlink.MAV_TYPE_GCS)

    def _on_command_int(self, message: MavlinkMessage) -> Answers:
        first = [getattr(message, f"param{i}") for i in range(1, 5)]
        latitude, longitude = (nan if abs(x) >= NO_COORDINATE else x / 1e7 for x in (message.x, message.y))
        if message.frame in ABOVE_SEA_LEVEL:
            yield from self._command(message, [*first, latitude, longitude, message.z])
        else:
            yield self._ack(message, UNSUPPORTED)

    def _on_ping(self, message: MavlinkMessage) -> Answers:
        if message.target_system == 0:
            yield mavlink.MAVLink_ping_message(
                message.time_usec, message.seq, message.get_srcSystem(), message.get_srcComponent()
            )

    def _on_file_transfer_protocol(self, message: MavlinkMessage) -> Answers:
        """There are no files: NAK, so that a client continues without them."""
        request = bytes(message.payload)
        reply = bytearray(251)
        sequence = int.from_bytes(request[:2], "little") + 1
        reply[:2] = (sequence & 0xFFFF).to_bytes(2, "little")
        reply[2] = request[2]  # the session, by which MAVProxy matches answers
        reply[3], reply[4], reply[5], reply[12] = 129, 1, request[3], 10  # NAK, one byte: file not found
        yield mavlink.MAVLink_file_transfer_protocol_message(
            0, message.get_srcSystem(), message.get_srcComponent(), reply
        )

    def _attitude_of(self, message: MavlinkMessage) -> AttitudeSetpoint | None:
        return setpoint_of(message, self._px4.quad.estimated_quaternion())

    def _course_of(self, message: MavlinkMessage) -> Course | None:
        """Accelerations are not followed."""
        position = _given(message, ("x", "y", "z"), IGNORE_POSITION, MAX_DISTANCE_M, nan)
        velocity = _given(message, ("vx", "vy", "vz"), IGNORE_VELOCITY, MAX_DISTANCE_M, nan)
        if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or not any(map(isfinite, (*position, *velocity))):
            return None
        yaw_rad, yaw_rate_rad_s = turn_of(message)
        yaw_rate_rad_s = yaw_rate_rad_s if isfinite(yaw_rate_rad_s) else 0.0
        return Course(enu_from_ned(position), enu_from_ned(velocity), yaw_rad, yaw_rate_rad_s)

    def _mode_parameters(self, custom_mode: int) -> tuple[float, ...]:
        return (custom_mode >> 16 & 0xFF, custom_mode >> 24 & 0xFF)

    def _on_set_gps_global_origin(self, message: MavlinkMessage) -> None:
        """Every link then sends the new origin."""
        if (origin := origin_of(message, self._px4)) is not None:
            self._px4.set_origin(origin)

    # ------------------------------------------------------------ commands

    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]:
        """Answered twice: accepted on receipt, then with the result of the mode change."""
        yield ACCEPTED
        try:
            mode = Px4Mode((int(parameters[1]), int(parameters[2])))
        except (ValueError, OverflowError):  # not a number, or not a mode
            self._px4.send_text(CRITICAL, "Unsupported auto mode")
            yield LATER
            return
        yield ACCEPTED if self._px4.set_mode(mode) else LATER

    def _enter_mode(self, name: str) -> Iterator[int]:
        yield ACCEPTED if self._px4.set_mode(Px4Mode[name]) else LATER

    def _arm_disarm(self, parameters: list[float]) -> Iterator[int]:
        forced = parameters[1] == FORCE
        if parameters[0] == 1.0:
            refusal, prefix = self._px4.arm(forced), "Arming denied: "
        elif parameters[0] == 0.0:
            refusal, prefix = self._px4.disarm(forced), "Disarming denied: "
        else:
            yield DENIED
            return
        if refusal:
            self._px4.send_text(CRITICAL, prefix + refusal)
        yield LATER if refusal else ACCEPTED

    def _take_off(self, parameters: list[float]) -> Iterator[int]:
        """Param 7 is above mean sea level; NaN selects MIS_TAKEOFF_ALT."""
        altitude = parameters[6]
        yield ACCEPTED if self._px4.take_off(altitude if isfinite(altitude) else None) else LATER

    def _reposition(self, parameters: list[float]) -> Iterator[int]:
        """To latitude, longitude and altitude above sea level; a value that is NaN is kept."""
        latitude, longitude, altitude = parameters[4:7]
        here = self._px4.here_geodetic()
        goal = [new if isfinite(new) else old for new, old in zip((latitude, longitude, altitude), here, strict=True)]
        position = enu_from_geodetic(goal[0], goal[1], goal[2], self._px4.quad.origin)
        yaw_ned = parameters[3]
        yaw = euler_enu_from_ned(0.0, 0.0, yaw_ned)[2] if isfinite(yaw_ned) else None
        if max(map(abs, position)) > MAX_DISTANCE_M:
            yield DENIED
        else:
            yield ACCEPTED if self._px4.go_to(position, yaw) else LATER

    def _mission_start(self, _parameters: list[float]) -> Iterator[int]:
        self._px4.send_text(CRITICAL, "Mission start denied! No valid mission")
        yield LATER

    def _set_interval(self, parameters: list[float]) -> Iterator[int]:
        known = all(map(isfinite, parameters[:2]))
        done = known and self._schedule.set_interval(int(parameters[0] + 0.5), parameters[1], self._px4.time_s)
        yield ACCEPTED if done else FAILED


class Px4LinkEnd(LinkEnd):
    """It sends the origin on change, and texts to ground stations only.

    With `connected_rates_hz` it sends at its first rates only until the peer has connected.
    """

    def __init__(self, px4: Px4, rates_hz: dict[int, float], connected_rates_hz: dict[int, float]) -> None:
        schedule = Px4Schedule(px4, rates_hz)
        codec = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        super().__init__(px4, schedule, Px4Receiver(px4, schedule), codec)
        self._connected_rates_hz = connected_rates_hz
        self.sends_changes = not connected_rates_hz

    def peer_connected(self) -> None:
        self.sends_changes = True
        if self._connected_rates_hz:
            self.schedule.reset(self._connected_rates_hz, self._autopilot.time_s)

    def _sends_texts(self) -> bool:
        """Only on a link with heartbeats of a ground station."""
        heartbeat_s = self.receiver.ground_station_s
        return heartbeat_s is not None and self._autopilot.time_s - heartbeat_s < GROUND_STATION_LOST_S


PX4 = AutopilotType(
    Px4,
    onboard_link=partial(Px4LinkEnd, rates_hz=ONBOARD_RATES_HZ, connected_rates_hz={}),
    ground_link=partial(Px4LinkEnd, rates_hz=HEARTBEAT_ONLY, connected_rates_hz=GROUND_RATES_HZ),
)
