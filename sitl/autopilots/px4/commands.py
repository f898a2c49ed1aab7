"""Incoming messages as PX4 handles them: commands with their double answers, setpoints. One entry per message."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, nan

from companion.geometry.frames import enu_from_geodetic, euler_enu_from_ned
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.autopilot import CRITICAL
from sitl.autopilots.px4.autopilot import Px4
from sitl.autopilots.px4.link import Px4Schedule
from sitl.autopilots.px4.logs import Px4LogTransfer
from sitl.autopilots.px4.messages import BUILDERS
from sitl.autopilots.px4.modes import Px4Mode
from sitl.autopilots.px4.setpoints import course_of, setpoint_of
from sitl.autopilots.setpoints import MAX_DISTANCE_M
from sitl.links.receiver import (
    ACCEPTED,
    DENIED,
    FAILED,
    FORCE,
    LATER,
    NO_COORDINATE,
    UNSUPPORTED,
    Answers,
    Receiver,
)

ABOVE_SEA_LEVEL = (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_FRAME_GLOBAL_INT)


class Px4Receiver(Receiver):
    """Incoming messages of one link."""

    _schedule: Px4Schedule

    def __init__(self, px4: Px4, schedule: Px4Schedule) -> None:
        super().__init__(px4, schedule)
        self._px4 = px4
        self.logs = Px4LogTransfer(px4)
        self._messages |= {
            "COMMAND_INT": self._command_int,
            "SET_MODE": self._set_mode_message,
            "SET_ATTITUDE_TARGET": self._set_attitude_target,
            "SET_POSITION_TARGET_LOCAL_NED": self._set_position_target,
            "SET_GPS_GLOBAL_ORIGIN": self._set_origin,
            **self.logs.requests,
        }
        self._commands |= {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._takeoff,
            mavlink.MAV_CMD_NAV_LAND: lambda _p: self._to(Px4Mode.LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _p: self._to(Px4Mode.RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda _p: self._to(Px4Mode.LOITER),
            mavlink.MAV_CMD_DO_REPOSITION: self._reposition,
            mavlink.MAV_CMD_MISSION_START: self._mission_start,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
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

    def _terminated(self, text: str) -> str:
        return text + "\t"

    def _requested(self, message_id: int) -> tuple[MavlinkMessage | None, int]:
        builder = BUILDERS.get(message_id)
        return (builder(self._px4), ACCEPTED) if builder else (None, DENIED)

    # ------------------------------------------------------------ messages

    def _is_of_ground_station(self, heartbeat: MavlinkMessage) -> bool:
        return bool(heartbeat.type == mavlink.MAV_TYPE_GCS)

    def _command_int(self, message: MavlinkMessage) -> Answers:
        first = [getattr(message, f"param{i}") for i in range(1, 5)]
        latitude, longitude = (nan if abs(x) >= NO_COORDINATE else x / 1e7 for x in (message.x, message.y))
        if message.frame in ABOVE_SEA_LEVEL:
            yield from self._command(message, [*first, latitude, longitude, message.z])
        else:
            yield self._ack(message, UNSUPPORTED)

    def _set_mode_message(self, message: MavlinkMessage) -> Answers:
        custom = message.custom_mode
        for _ in self._do_set_mode([1.0, custom >> 16 & 0xFF, custom >> 24 & 0xFF]):
            pass
        yield from ()

    def _set_attitude_target(self, message: MavlinkMessage) -> Answers:
        setpoint = setpoint_of(message, self._px4.quad.estimated_quaternion())
        if setpoint is not None:
            self._px4.take_setpoint(setpoint)
        yield from ()

    def _set_position_target(self, message: MavlinkMessage) -> Answers:
        course = course_of(message)
        if course is not None:
            self._px4.take_setpoint(course)
        yield from ()

    def _set_origin(self, message: MavlinkMessage) -> Answers:
        """Every link then sends the new origin. The stand-in's world is flat, so distant origins are rejected."""
        origin = (message.latitude / 1e7, message.longitude / 1e7, message.altitude / 1e3)
        if max(map(abs, enu_from_geodetic(*origin, self._px4.quad.world_origin))) <= MAX_DISTANCE_M:
            self._px4.set_origin(origin)
        yield from ()

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

    def _to(self, mode: Px4Mode) -> Iterator[int]:
        yield ACCEPTED if self._px4.set_mode(mode) else LATER

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

    def _takeoff(self, parameters: list[float]) -> Iterator[int]:
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
