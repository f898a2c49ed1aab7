"""Incoming messages as ArduCopter handles them: commands with one answer each, setpoints. One entry per message."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite

from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.ardupilot.autopilot import ArduCopter, SigningSetup
from sitl.autopilots.ardupilot.logs import ArduPilotLogTransfer
from sitl.autopilots.ardupilot.messages import BUILDERS
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.ardupilot.setpoints import course_of, setpoint_of
from sitl.autopilots.autopilot import CRITICAL, INFO, WARNING
from sitl.links.receiver import ACCEPTED, DENIED, FAILED, FORCE, Answers, Receiver
from sitl.links.schedule import Schedule

SHORTEST_INTERVAL_US = 2000.0  # 0.8 of the period of a 400 Hz loop; shorter intervals, and this one, are too fast


class ArduPilotReceiver(Receiver):
    """Incoming messages of one link. The sender is not checked, and of the target only the system."""

    def __init__(self, copter: ArduCopter, schedule: Schedule) -> None:
        super().__init__(copter, schedule)
        self._copter = copter
        self.logs = ArduPilotLogTransfer(
            copter, copter.log_service, lambda severity, text: self.texts([(severity, text)])
        )
        del self._messages["PING"], self._messages["FILE_TRANSFER_PROTOCOL"]
        self._messages |= {
            "SET_MODE": self._set_mode_message,
            "SET_ATTITUDE_TARGET": self._set_attitude_target,
            "SET_POSITION_TARGET_LOCAL_NED": self._set_position_target,
            "SETUP_SIGNING": self._setup_signing,
            **self.logs.requests,
        }
        self._commands |= {
            mavlink.MAV_CMD_DO_SET_MODE: self._do_set_mode,
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_NAV_LAND: lambda _p: self._to(CopterMode.LAND),
            mavlink.MAV_CMD_NAV_RETURN_TO_LAUNCH: lambda _p: self._to(CopterMode.RTL),
            mavlink.MAV_CMD_NAV_LOITER_UNLIM: lambda _p: self._to(CopterMode.LOITER),
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
        }

    def _is_for_it(self, message: MavlinkMessage) -> bool:
        return getattr(message, "target_system", 0) in (0, self._copter.system_id)

    def _terminated(self, text: str) -> str:
        return text

    def _requested(self, message_id: int) -> tuple[MavlinkMessage | None, int]:
        """Accepted also if the message has no data yet."""
        builder = BUILDERS.get(message_id)
        return (builder(self._copter), ACCEPTED) if builder else (None, FAILED)

    # ------------------------------------------------------------ messages

    def _is_of_ground_station(self, heartbeat: MavlinkMessage) -> bool:
        return bool(heartbeat.get_srcSystem() == self._copter.parameters["SYSID_MYGCS"])

    def _set_mode_message(self, message: MavlinkMessage) -> Answers:
        for _ in self._do_set_mode([1.0, float(message.custom_mode)]):
            pass
        yield from ()

    def _set_attitude_target(self, message: MavlinkMessage) -> Answers:
        if self._copter.mode is CopterMode.GUIDED:
            setpoint = setpoint_of(message)
            if setpoint is None:
                self._copter.stop()
            else:
                self._copter.take_setpoint(setpoint)
        yield from ()

    def _set_position_target(self, message: MavlinkMessage) -> Answers:
        course = course_of(message)
        if course is None:
            self._copter.stop()
        else:
            self._copter.take_setpoint(course)
        yield from ()

    def _setup_signing(self, message: MavlinkMessage) -> Answers:
        """No answer; from then on every link is signed. A key and a timestamp of zeros end signing."""
        key = bytes(message.secret_key)
        if self._copter.armed:
            self._copter.send_text(WARNING, "ERROR: Won't setup signing when armed")
        elif not any(key) and message.initial_timestamp == 0:
            self._copter.signing = None
        else:
            self._copter.signing = SigningSetup(key, message.initial_timestamp, self._copter.time_s)
        yield from ()

    # ------------------------------------------------------------ commands

    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]:
        number = int(parameters[1]) if isfinite(parameters[1]) else -1
        if number not in list(CopterMode):
            self._copter.send_text(WARNING, f"No such mode {number}")
            yield FAILED
        else:
            yield from self._to(CopterMode(number))

    def _to(self, mode: CopterMode) -> Iterator[int]:
        refusal = self._copter.set_mode(mode)
        if refusal:
            self._copter.send_text(WARNING, refusal)
        yield FAILED if refusal else ACCEPTED

    def _arm_disarm(self, parameters: list[float]) -> Iterator[int]:
        forced = parameters[1] == FORCE
        if parameters[0] == 1.0:
            reasons = self._copter.arm(forced)
            for reason in reasons:
                self._copter.send_text(CRITICAL, f"Arm: {reason}")
            yield FAILED if reasons else ACCEPTED
        elif parameters[0] == 0.0:
            yield ACCEPTED if self._copter.disarm(forced) else FAILED
        else:
            yield DENIED

    def _take_off(self, parameters: list[float]) -> Iterator[int]:
        """Param 7 is the height above home."""
        height = parameters[6]
        yield ACCEPTED if isfinite(height) and self._copter.take_off(height) else FAILED

    def _set_interval(self, parameters: list[float]) -> Iterator[int]:
        """0 is the default, -1 off; unknown messages and too high rates are denied with a text."""
        number, interval_us = parameters[:2]
        if not isfinite(number) or not isfinite(interval_us) or int(number) not in BUILDERS:
            self._copter.send_text(INFO, f"No ap_message for mavlink id ({number:.0f})")
            yield DENIED
        elif 0.0 < interval_us <= SHORTEST_INTERVAL_US:
            self._copter.send_text(
                INFO, f"Requested rate for message ID {number:.0f} too fast. Increase SCHED_LOOP_RATE"
            )
            yield DENIED
        else:
            default_hz = self._schedule.default_hz(int(number))
            rate_hz = default_hz if interval_us == 0.0 else 1e6 / interval_us
            self._schedule.set_rate(int(number), rate_hz, self._copter.time_s)
            yield ACCEPTED
