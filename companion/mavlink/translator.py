"""MAVLink of one vehicle: bytes -> Telemetry, setpoints and requests -> bytes. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Sequence
from math import isfinite

from companion.geometry.frames import euler_from_quaternion, euler_ned_from_enu, ned_from_enu, quaternion_from_euler
from companion.mavlink import telemetry
from companion.mavlink.autopilot_types import DIALECTS, autopilot_kind, describe_heartbeat
from companion.mavlink.clock import AutopilotClock
from companion.mavlink.codec import SIGNATURE_CODES, MavlinkCodec, Packet, SigningKey, mavlink
from companion.mavlink.dialect import Dialect, stream_request
from companion.mavlink.senders import AUTOPILOT, OtherSenders, StreamOrder
from companion.types.autopilot import (
    AttitudeTarget,
    AutopilotKind,
    AutopilotRequest,
    ModeSample,
    ParameterSample,
    Telemetry,
    ThrustSample,
)
from companion.types.notices import Code
from companion.types.peers import BodyPose

THRUST_DECIMALS = 5
ANSWERS_KEPT = 8

Samples = tuple[Telemetry, ...]


def pose_covariance(position_error_m: float, angle_error_rad: float) -> tuple[float, ...]:
    """Of VISION_POSITION_ESTIMATE: upper triangle of x, y, z, roll, pitch, yaw, from one sigma of each."""
    squares = [position_error_m**2] * 3 + [angle_error_rad**2] * 3
    return tuple(squares[row] if row == column else 0.0 for row in range(6) for column in range(row, 6))


class Translator:
    """Receives only from the autopilot of system id `vehicle_id`; sends as onboard computer of the same system.

    `autopilot` selects the dialect. Where it is None the first HEARTBEAT does, and nothing can be sent before. A HEARTBEAT of
    another make is refused.
    """

    def __init__(self, vehicle_id: int, autopilot: AutopilotKind | None = None, key: SigningKey | None = None) -> None:
        self._system_id = vehicle_id
        self._codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, key)
        self._beside_codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, key)
        self._relay_codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._has_key = key is not None
        self._texts = telemetry.TextAssembler()
        self.clock = AutopilotClock()
        self.answers: deque[bytes] = deque(maxlen=ANSWERS_KEPT)  # to what the last bytes asked, to be sent
        self.rejected: Counter[str] = Counter()  # damaged or implausible packets, by code
        self.others = OtherSenders()
        self._order = StreamOrder()
        self.refused_signature: Code | None = None  # why the last packet with a wrong signature was refused
        self.lacks_key = False  # the autopilot signs, and this agent has no key
        self._autopilot = autopilot
        self.refused_heartbeat = ""  # reason for the last refused HEARTBEAT
        self._samples_of: dict[int, Callable[[Packet, float], Samples]] = {
            mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED: self._position,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION: self._attitude,
            mavlink.MAVLINK_MSG_ID_CURRENT_MODE: self._mode,
            mavlink.MAVLINK_MSG_ID_ATTITUDE_TARGET: self._thrust,
            mavlink.MAVLINK_MSG_ID_HEARTBEAT: self._heartbeat,
            mavlink.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: lambda p, s: (telemetry.landed(p.fields, s),),
            mavlink.MAVLINK_MSG_ID_SYS_STATUS: lambda p, s: (telemetry.system(p.fields, s),),
            mavlink.MAVLINK_MSG_ID_GLOBAL_POSITION_INT: lambda p, s: (telemetry.global_position(p.fields, s),),
            mavlink.MAVLINK_MSG_ID_ESTIMATOR_STATUS: lambda p, s: (telemetry.estimator_status(p.fields, s),),
            mavlink.MAVLINK_MSG_ID_GPS_RAW_INT: self._gps_error,
            mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN: lambda p, s: (telemetry.origin(p.fields, s),),
            mavlink.MAVLINK_MSG_ID_HOME_POSITION: lambda p, s: (telemetry.home(p.message, s),),
            mavlink.MAVLINK_MSG_ID_MISSION_CURRENT: lambda p, s: (telemetry.rally_points(p.payload, s),),
            mavlink.MAVLINK_MSG_ID_PARAM_VALUE: self._parameter,
            mavlink.MAVLINK_MSG_ID_COMMAND_ACK: self._acknowledgement,
            mavlink.MAVLINK_MSG_ID_STATUSTEXT: self._text,
            mavlink.MAVLINK_MSG_ID_TIMESYNC: self._timesync,
        }

    @property
    def dialect(self) -> Dialect:
        """Dialect of the autopilot. Raises LookupError before its make is known."""
        if self._autopilot is None:
            raise LookupError("no HEARTBEAT yet: the make of the autopilot is unknown")
        return DIALECTS[self._autopilot]

    def telemetry(self, data: bytes, received_s: float) -> list[Telemetry]:
        """All samples in these bytes, in order."""
        samples: list[Telemetry] = []
        for packet in self._codec.read(data):
            if packet.system_id != self._system_id or packet.component_id != AUTOPILOT:
                self.others.receive(packet)
            else:
                self._order.receive(packet, received_s)
                self.lacks_key = not self._has_key and packet.is_signed
                if (samples_of := self._samples_of.get(packet.message_id)) is not None:
                    samples += samples_of(packet, received_s)
        if refused := self._codec.refused:
            self.rejected.update(refused)
            self.refused_signature = next((code for code in SIGNATURE_CODES if code in refused), self.refused_signature)
            refused.clear()
        return samples

    def receive_beside(self, data: bytes, received_s: float) -> bool:
        """Bytes from elsewhere than the autopilot's address. Whether packets with its id arrive there and here in turn."""
        for packet in self._beside_codec.read(data):
            if packet.system_id == self._system_id and packet.component_id == AUTOPILOT:
                self._order.receive_beside(received_s)
        self._beside_codec.refused.clear()
        return self._order.interleaves(received_s)

    @property
    def packets(self) -> Sequence[Packet]:
        """Accepted packets of the last bytes, unchanged, including those of other systems and components."""
        return self._codec.packets

    def _position(self, packet: Packet, received_s: float) -> Samples:
        position = telemetry.position(packet.values, received_s, self.clock)
        self._order.receive_clock(position.boot_time_s, received_s)
        return (position,)

    def _attitude(self, packet: Packet, received_s: float) -> Samples:
        attitude = telemetry.attitude(packet.values, received_s)
        if attitude is None:
            self.rejected[Code.ATTITUDE_INVALID] += 1
            return ()
        return (attitude,)

    def _heartbeat(self, packet: Packet, received_s: float) -> Samples:
        message = packet.fields
        kind = autopilot_kind(message)
        if kind is None or self._autopilot not in (None, kind):
            self.refused_heartbeat = (
                f"HEARTBEAT reports {describe_heartbeat(message)}, expected {self._describe_expected()}"
            )
            self.rejected[Code.AUTOPILOT_OTHER_MAKE] += 1
            return ()
        self._autopilot = kind
        mode = ModeSample(received_s, *self.dialect.mode_of(message.custom_mode))
        interleaves = self._order.interleaves(received_s)
        return (telemetry.heartbeat(message, kind, received_s, interleaves), mode)

    def _describe_expected(self) -> str:
        expected = [DIALECTS[self._autopilot]] if self._autopilot else list(DIALECTS.values())
        return " or ".join(f"{dialect.MAV_AUTOPILOT} ({dialect.NAME})" for dialect in expected)

    def _mode(self, packet: Packet, received_s: float) -> Samples:
        if self._autopilot is None:
            return ()
        custom_mode, *_ = packet.values
        return (ModeSample(received_s, *self.dialect.mode_of(custom_mode)),)

    def _thrust(self, packet: Packet, received_s: float) -> Samples:
        if self._autopilot is None:
            return ()
        _, w, x, y, z, _, _, _, thrust, *_ = packet.values
        thrust_norm = self.dialect.commanded_thrust(thrust, (w, x, y, z))
        return (ThrustSample(received_s, round(thrust_norm, THRUST_DECIMALS)),)

    def _parameter(self, packet: Packet, received_s: float) -> Samples:
        if self._autopilot is None:
            return ()
        message = packet.message
        value = self.dialect.parameter_value(message)
        if not isfinite(value):
            self.rejected[Code.PARAMETER_NOT_FINITE] += 1
            return ()
        return (ParameterSample(received_s, message.param_id, value),)

    def _gps_error(self, packet: Packet, received_s: float) -> Samples:
        if self._autopilot is None or mavlink.MAVLINK_MSG_ID_GPS_RAW_INT not in self.dialect.STREAMS_US:
            return ()
        return (telemetry.gps_error(packet.fields, received_s),)

    def _acknowledgement(self, packet: Packet, received_s: float) -> Samples:
        message = packet.fields
        if message.target_system not in (0, self._system_id):
            return ()  # addressed to a ground station on the same link
        return (telemetry.acknowledgement(message, received_s),)

    def _text(self, packet: Packet, received_s: float) -> Samples:
        text = self._texts.add(packet.message, received_s)
        return (text,) if text else ()

    def _timesync(self, packet: Packet, received_s: float) -> Samples:
        """A request, tc1 0, is answered by the autopilot's own clock, once known: the stamps of poses are of that one."""
        message = packet.fields
        if message.tc1:
            self.clock.receive_answer(message.ts1, message.tc1, received_s)
        elif boot_ns := round(self.clock.boot_s(received_s) * 1e9):
            self.answers.append(self._codec.encode(mavlink.MAVLink_timesync_message(boot_ns, message.ts1)))
        return ()

    def attitude_target(self, target: AttitudeTarget, now_s: float) -> bytes:
        """SET_ATTITUDE_TARGET with attitude and thrust; `now_s` becomes its time_boot_ms."""
        euler_ned = euler_ned_from_enu(target.roll_rad, target.pitch_rad, target.yaw_rad)
        no_rate_rad_s = (0.0, 0.0, 0.0)
        return self._codec.encode_values(
            mavlink.MAVLINK_MSG_ID_SET_ATTITUDE_TARGET,
            int(now_s * 1000.0) & 0xFFFFFFFF,
            *quaternion_from_euler(*euler_ned),
            *no_rate_rad_s,
            self.dialect.thrust_of(target),
            self._system_id,
            AUTOPILOT,
            self.dialect.ATTITUDE_TYPE_MASK,
        )

    def pose(self, pose: BodyPose, measured_s: float, covariance: Sequence[float], resets: int) -> bytes:
        """VISION_POSITION_ESTIMATE of a pose that was measured at this time of the clock of `received_s`."""
        x, y, z = ned_from_enu(pose.position_enu_m)
        roll_rad, pitch_rad, yaw_rad = euler_ned_from_enu(*euler_from_quaternion(pose.quaternion))
        stamp_us = round(self.clock.boot_s(measured_s) * 1e6)
        return self._codec.encode(
            mavlink.MAVLink_vision_position_estimate_message(
                stamp_us, x, y, z, roll_rad, pitch_rad, yaw_rad, covariance, resets & 0xFF
            )
        )

    def request(self, request: AutopilotRequest) -> bytes:
        """The MAVLink packet of a request."""
        return self._codec.encode(self.dialect.command_for(request, self._system_id))

    def relay(self, data: bytes) -> list[bytes]:
        """Messages of another program as packets of this link, signed where the link is signed."""
        return [self._codec.encode(message) for message in self._relay_codec.decode(data)]

    def heartbeat(self) -> bytes:
        """HEARTBEAT of an onboard computer. That of a ground station would hide a lost ground station from the autopilot."""
        return self._codec.encode(
            mavlink.MAVLink_heartbeat_message(
                mavlink.MAV_TYPE_ONBOARD_CONTROLLER,
                mavlink.MAV_AUTOPILOT_INVALID,
                0,
                0,
                mavlink.MAV_STATE_ACTIVE,
                3,
            )
        )

    def time_request(self, now_s: float) -> bytes:
        """TIMESYNC, to be sent at `now_s` on the clock of `received_s`."""
        return self._codec.encode(mavlink.MAVLink_timesync_message(0, self.clock.request(now_s)))

    def stream_requests(self) -> list[bytes]:
        """Requests for the message intervals of the dialect (MAV_CMD_SET_MESSAGE_INTERVAL)."""
        return [
            self._codec.encode(stream_request(self._system_id, message_id, interval_us))
            for message_id, interval_us in self.dialect.STREAMS_US.items()
        ]
