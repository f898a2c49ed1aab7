"""ArduCopter's end of a link: setpoints, commands with one answer each, signing. Every link sends little until asked."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from math import isfinite, isnan, nan

from companion.geometry.frames import (
    enu_from_ned,
    euler_enu_from_ned,
    euler_from_quaternion,
    flu_from_frd,
    quaternion_from_euler,
)
from companion.mavlink.codec import EPOCH_UNIX_S, UNITS_PER_S, MavlinkCodec, MavlinkMessage, SigningKey, mavlink
from companion.types.values import ZERO3, Vector3
from sitl.autopilots.ardupilot.autopilot import ArduCopter, SigningSetup
from sitl.autopilots.ardupilot.logs import ArduPilotLogTransfer
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.autopilot import CRITICAL, INFO, WARNING, AutopilotAbortedError
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
    AutopilotType,
    LinkEnd,
    Receiver,
    Schedule,
    origin_of,
    turn_of,
)
from sitl.autopilots.parameters import rates_by_id
from sitl.vehicle.automatic_flight import Course
from sitl.vehicle.control import AttitudeSetpoint

SQUARE_OF_UNIT_WITHIN = 1e-3
NO_VECTOR: Vector3 = (nan, nan, nan)
SHORTEST_INTERVAL_US = 2000.0  # 0.8 of the period of a 400 Hz loop; shorter intervals, and this one, are too fast


def setpoint_of(message: MavlinkMessage) -> AttitudeSetpoint | None:
    """The setpoint, None to stop. The thrust is as sent; its meaning depends on GUID_OPTIONS.

    Raises AutopilotAbortedError for a NaN quaternion, which aborts the real autopilot by a floating point exception.
    """
    mask = message.type_mask
    if mask & IGNORE_THROTTLE:
        return None
    no_rates = mask & sum(IGNORE_RATES)
    if not mask & IGNORE_ATTITUDE:
        if any(map(isnan, message.q)):
            raise AutopilotAbortedError("SET_ATTITUDE_TARGET with a quaternion that is not a number")
        if abs(sum(part * part for part in message.q) - 1.0) > SQUARE_OF_UNIT_WITHIN:
            return None
    if no_rates not in (0, sum(IGNORE_RATES)):
        return None
    p, q, r = flu_from_frd((message.body_roll_rate, message.body_pitch_rate, message.body_yaw_rate))
    rates = ZERO3 if no_rates else (p, q, r)
    if mask & IGNORE_ATTITUDE:
        return AttitudeSetpoint((1.0, 0.0, 0.0, 0.0), message.thrust, rates_rad_s=rates)
    euler = euler_enu_from_ned(*euler_from_quaternion(tuple(message.q)))
    return AttitudeSetpoint(quaternion_from_euler(*euler), message.thrust, yaw_rate_rad_s=rates[2])


class ArduPilotReceiver(Receiver):
    """Incoming messages of one link. The sender is not checked, and of the target only the system."""

    UNKNOWN_MESSAGE = FAILED

    def __init__(self, copter: ArduCopter, schedule: Schedule) -> None:
        super().__init__(copter, schedule)
        self._copter = copter
        self.logs = ArduPilotLogTransfer(
            copter, copter.log_service, lambda severity, text: self.texts([(severity, text)])
        )
        self._commands |= {
            mavlink.MAV_CMD_COMPONENT_ARM_DISARM: self._arm_disarm,
            mavlink.MAV_CMD_NAV_TAKEOFF: self._take_off,
            mavlink.MAV_CMD_SET_MESSAGE_INTERVAL: self._set_interval,
        }

    def _is_for_it(self, message: MavlinkMessage) -> bool:
        return getattr(message, "target_system", 0) in (0, self._copter.system_id)

    # ------------------------------------------------------------ messages

    def _is_of_ground_station(self, heartbeat: MavlinkMessage) -> bool:
        return bool(heartbeat.get_srcSystem() == self._copter.parameters["SYSID_MYGCS"])

    def _attitude_of(self, message: MavlinkMessage) -> AttitudeSetpoint | None:
        return setpoint_of(message)

    def _course_of(self, message: MavlinkMessage) -> Course | None:
        """A position or velocity is given with all axes or none; accelerations are not followed."""
        mask = message.type_mask
        position = NO_VECTOR if mask & sum(IGNORE_POSITION) else enu_from_ned((message.x, message.y, message.z))
        velocity = NO_VECTOR if mask & sum(IGNORE_VELOCITY) else enu_from_ned((message.vx, message.vy, message.vz))
        if message.coordinate_frame != mavlink.MAV_FRAME_LOCAL_NED or (position is NO_VECTOR and velocity is NO_VECTOR):
            return None
        return Course(position, velocity, *turn_of(message))

    def _mode_parameters(self, custom_mode: int) -> tuple[float, ...]:
        return (float(custom_mode),)

    def _on_set_gps_global_origin(self, message: MavlinkMessage) -> None:
        """Silently ignored where there is an origin."""
        origin = origin_of(message, self._copter)
        if origin is not None and self._copter.vision is not None and not self._copter.has_origin:
            self._copter.set_origin(origin)

    def _on_setup_signing(self, message: MavlinkMessage) -> None:
        """No answer; from then on every link is signed. A key and a timestamp of zeros end signing."""
        key = bytes(message.secret_key)
        if self._copter.armed:
            self._copter.send_text(WARNING, "ERROR: Won't setup signing when armed")
        elif not any(key) and message.initial_timestamp == 0:
            self._copter.signing = None
        else:
            self._copter.signing = SigningSetup(key, message.initial_timestamp, self._copter.time_s)

    # ------------------------------------------------------------ commands

    def _do_set_mode(self, parameters: list[float]) -> Iterator[int]:
        number = int(parameters[1]) if isfinite(parameters[1]) else -1
        if number not in list(CopterMode):
            self._copter.send_text(WARNING, f"No such mode {number}")
            yield FAILED
        else:
            yield from self._enter_mode(CopterMode(number).name)

    def _enter_mode(self, name: str) -> Iterator[int]:
        refusal = self._copter.set_mode(CopterMode[name])
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
        if not isfinite(number) or not isfinite(interval_us) or int(number) not in self._copter.data.message_ids:
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


class ArduPilotLinkEnd(LinkEnd):
    """All links behave alike; `link_id` is that of signing."""

    ON_CHANGE = (mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, mavlink.MAVLINK_MSG_ID_HOME_POSITION)

    def __init__(self, copter: ArduCopter, link_id: int) -> None:
        schedule = Schedule(rates_by_id(copter.data.onboard_rates_hz))
        super().__init__(copter, schedule, ArduPilotReceiver(copter, schedule), codec_of(copter, link_id))
        self._copter = copter
        self._link_id = link_id
        self._signing = copter.signing
        self._origin_sent = 0

    def _codec_now(self) -> MavlinkCodec:
        """With a key all packets are signed, and unsigned packets are dropped silently."""
        if self._copter.signing is not self._signing:
            self._signing = self._copter.signing
            self._codec = codec_of(self._copter, self._link_id)
        return self._codec


def codec_of(copter: ArduCopter, link_id: int) -> MavlinkCodec:
    """The codec of the present signing. Timestamps continue from that of SETUP_SIGNING."""
    signing = copter.signing
    if signing is None:
        return MavlinkCodec(copter.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)

    def unix_time_s() -> float:
        return EPOCH_UNIX_S + signing.stamp / UNITS_PER_S + copter.time_s - signing.set_s

    key = SigningKey(signing.key, link_id, unix_time_s)
    return MavlinkCodec(copter.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1, key)


_onboard, _ground, _tcp = (partial(ArduPilotLinkEnd, link_id=link_id) for link_id in (1, 2, 0))
ARDUPILOT = AutopilotType(ArduCopter, _onboard, _ground, _tcp)
