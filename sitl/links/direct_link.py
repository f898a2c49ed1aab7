"""The MAVLink link between a stand-in and its agent in virtual time, without sockets, with a delay in both directions.

Messages at 50 Hz are passed as the typed values that the translator makes of their bytes; requests and their answers are
encoded and decoded as real MAVLink.
"""

from __future__ import annotations

import struct
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from math import inf

from msgspec.structs import replace

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink import telemetry
from companion.mavlink.autopilot_types import DIALECTS
from companion.mavlink.clock import REQUEST_PERIOD_S
from companion.mavlink.codec import MavlinkMessage, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import (
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotRequest,
    EstimatorSample,
    HeartbeatSample,
    LandedSample,
    LandedState,
    ModeSample,
    PositionSample,
    RallySample,
    SystemSample,
    Telemetry,
    ThrustSample,
)
from companion.types.peers import BodyPose
from sitl.autopilots.autopilot import Autopilot
from sitl.autopilots.link_end import LinkEnd
from sitl.autopilots.messages import Builder, estimator_status, global_position, gps_raw, home_position
from sitl.vehicle.config import Links
from sitl.vehicle.control import AttitudeSetpoint

M = mavlink
_TWO_FLOATS = struct.Struct("<2f")
_FLOAT = struct.Struct("<f")
_FLOATS = struct.Struct("<6f")  # MAVLink's floats have 32 bits: a resolution of micrometres at 10 m


def rates_hz(kind: AutopilotKind) -> dict[int, float]:
    """Rates of the messages that the agent requests."""
    asked = {message_id: 1e6 / us for message_id, us in DIALECTS[kind].STREAMS_US.items() if us > 0}
    return {M.MAVLINK_MSG_ID_HEARTBEAT: 1.0} | asked


Samples = tuple[Telemetry, ...]


def _mode(autopilot: Autopilot, received_s: float) -> Samples:
    return (ModeSample(received_s, *DIALECTS[autopilot.kind].mode_of(autopilot.mode.custom_mode)),)


def _heartbeat(autopilot: Autopilot, received_s: float) -> Samples:
    critical = autopilot.reported_status in telemetry.FAILSAFE_STATES
    sample = HeartbeatSample(received_s, autopilot.armed, autopilot.kind, critical)
    return (sample, *_mode(autopilot, received_s))


def _position(autopilot: Autopilot, received_s: float) -> Samples:
    if not autopilot.reports_position:
        return ()
    position_enu_m, velocity_enu_m_s = autopilot.local_state()
    x, y, z, vx, vy, vz = _FLOATS.unpack(_FLOATS.pack(*position_enu_m, *velocity_enu_m_s))
    return (PositionSample(received_s, autopilot.boot_ms / 1000.0, (x, y, z), (vx, vy, vz)),)


def _thrust(autopilot: Autopilot, received_s: float) -> Samples:
    (thrust_norm,) = _FLOAT.unpack(_FLOAT.pack(autopilot.setpoint.thrust_norm))
    return (ThrustSample(received_s, thrust_norm),)


def _error(autopilot: Autopilot, received_s: float) -> Samples:
    message = estimator_status(autopilot)
    errors_m = _TWO_FLOATS.unpack(_TWO_FLOATS.pack(message.pos_horiz_accuracy, message.pos_vert_accuracy))
    status = telemetry.estimator_status(message, received_s)
    horizontal_m, vertical_m = errors_m
    return (EstimatorSample(received_s, horizontal_m, vertical_m, status.healthy, status.aid),)


def _read(build: Builder, read: Callable[[MavlinkMessage, float], Telemetry]) -> Callable[[Autopilot, float], Samples]:
    """The sample of a message, if the autopilot sends one."""

    def samples(autopilot: Autopilot, received_s: float) -> Samples:
        message = build(autopilot)
        return () if message is None else (read(message, received_s),)

    return samples


# The attitude is without the 32-bit quaternion, which changes it by less than a microradian.
SAMPLES: dict[int, Callable[[Autopilot, float], Samples]] = {
    M.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    M.MAVLINK_MSG_ID_CURRENT_MODE: _mode,
    M.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _position,
    M.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: lambda own, at_s: (AttitudeSample(at_s, *own.quad.estimated_euler_rad()),),
    M.MAVLINK_MSG_ID_ATTITUDE_TARGET: _thrust,
    M.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: lambda own, at_s: (LandedSample(at_s, LandedState(own.landed_state)),),
    M.MAVLINK_MSG_ID_SYS_STATUS: lambda own, at_s: (SystemSample(at_s, float(own.battery_percent), own.armable),),
    M.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: _read(global_position, telemetry.global_position),
    M.MAVLINK_MSG_ID_HOME_POSITION: _read(home_position, telemetry.home),
    M.MAVLINK_MSG_ID_MISSION_CURRENT: lambda own, at_s: (RallySample(at_s, bool(own.rally_points)),),
    M.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _error,
    M.MAVLINK_MSG_ID_GPS_RAW_INT: _read(gps_raw, telemetry.gps_error),
}


def setpoint_of(kind: AutopilotKind, target: AttitudeTarget) -> AttitudeSetpoint:
    """The stand-in's setpoint for this SET_ATTITUDE_TARGET, without rounding to 32 bits."""
    thrust = DIALECTS[kind].thrust_of(target)
    return AttitudeSetpoint(quaternion_from_euler(target.roll_rad, target.pitch_rad, target.yaw_rad), thrust)


class DirectLink:
    """One link. Times are of the world's clock. Telemetry begins at `phase_s`."""

    def __init__(self, autopilot: Autopilot, end: LinkEnd, links: Links, phase_s: float) -> None:
        self.autopilot = autopilot
        self._telemetry_delay_s = links.telemetry_delay_s
        self._setpoint_delay_s = links.setpoint_delay_s
        self._late = [late for late in links.late_telemetry if late.vehicle == autopilot.system_id]
        self._last_s = self._time_asked_s = -inf
        self.end = end
        self.schedule = end.schedule
        unasked = {M.MAVLINK_MSG_ID_MISSION_CURRENT: self.schedule.default_hz(M.MAVLINK_MSG_ID_MISSION_CURRENT)}
        self.schedule.reset(unasked | rates_hz(autopilot.kind), phase_s)
        self._translator = Translator(autopilot.system_id, autopilot.kind)
        self._to_agent: deque[Telemetry] = deque()  # in the order of `received_s`
        self._positions_s: deque[float] = deque()  # when those among them arrive
        self.position_s = inf  # when the next one does, which triggers a tick; infinite where none is on its way
        self.setpoint_s = -inf  # when the agent sent its last attitude target
        self.target = AttitudeTarget(0.0, 0.0, 0.0, 0.0)  # that one
        self.to_autopilot: deque[tuple[float, AttitudeSetpoint | bytes]] = deque()  # what is on its way there

    # ------------------------------------------------------------ the autopilot's end

    def deliver(self, now_s: float) -> None:
        """Deliver to the autopilot what has arrived by now."""
        while self.to_autopilot and self.to_autopilot[0][0] <= now_s:
            _, what = self.to_autopilot.popleft()
            if isinstance(what, AttitudeSetpoint):
                self.autopilot.take_setpoint(what)
            else:
                self._send(self.end.receive(what), now_s)

    def send_telemetry(self, now_s: float) -> None:
        """Send the texts and the telemetry that are due."""
        if self.autopilot.texts:
            self._send(self.end.texts(), now_s)
            self.autopilot.texts.clear()
        if self.autopilot.origin_changes and self.end.has_changes:  # the agent requests the first one itself
            self._send(self.end.changes(), now_s)
        if now_s < self.schedule.next_s:
            return
        received_s = self._received_s(now_s)
        for message_id in self.schedule.due(now_s):
            samples = SAMPLES[message_id](self.autopilot, received_s)
            if samples and message_id == M.MAVLINK_MSG_ID_LOCAL_POSITION_NED:
                self._positions_s.append(received_s)
                self.position_s = self._positions_s[0]
                if late_s := self._late_s(now_s, received_s):
                    samples = (replace(samples[0], late_s=late_s),)
            self._to_agent.extend(samples)

    def _late_s(self, now_s: float, received_s: float) -> float:
        """Age on arrival of a position that is sent now."""
        clock, boot_s = self._translator.clock, self.autopilot.boot_ms / 1000.0
        if now_s >= self._time_asked_s + REQUEST_PERIOD_S:  # TIMESYNC is answered beside it
            self._time_asked_s = now_s
            clock.exchange(now_s - self._setpoint_delay_s, boot_s, received_s)
        return clock.late_s(boot_s, received_s)

    def _received_s(self, now_s: float) -> float:
        """When what is sent now arrives: late at times, never before what was sent before it."""
        if not self._late:
            return now_s + self._telemetry_delay_s
        delays_s = [late.delay_s for late in self._late if late.from_s <= now_s < late.until_s]
        self._last_s = max(self._last_s, now_s + (delays_s[0] if delays_s else self._telemetry_delay_s))
        return self._last_s

    def _send(self, packets: Iterator[bytes], now_s: float) -> None:
        for packet in packets:
            self._to_agent.extend(self._translator.telemetry(packet, self._received_s(now_s)))

    # ------------------------------------------------------------ the agent's end

    def take_position(self) -> None:
        """The next position has triggered its tick."""
        self._positions_s.popleft()
        self.position_s = self._positions_s[0] if self._positions_s else inf

    def drain(self, now_s: float) -> tuple[Telemetry, ...]:
        """All telemetry that has arrived since the last call."""
        waiting, arrived = self._to_agent, []
        while waiting and waiting[0].received_s <= now_s:
            arrived.append(waiting.popleft())
        return tuple(arrived)

    def command(self, target: AttitudeTarget, now_s: float) -> None:
        self.target, self.setpoint_s = target, now_s
        self.to_autopilot.append((now_s + self._setpoint_delay_s, setpoint_of(self.autopilot.kind, target)))

    def pose(self, now_s: float, pose: BodyPose, measured_s: float, covariance: Sequence[float], resets: int) -> None:
        packet = self._translator.pose(pose, measured_s, covariance, resets)
        self.to_autopilot.append((now_s + self._setpoint_delay_s, packet))

    def request(self, request: AutopilotRequest, now_s: float) -> None:
        self.to_autopilot.append((now_s + self._setpoint_delay_s, self._translator.request(request)))
