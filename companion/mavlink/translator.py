"""MAVLink of one vehicle: bytes -> Telemetry, setpoints and requests -> bytes. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter
from math import isfinite

from companion.geometry.frames import euler_ned_from_enu, quaternion_from_euler
from companion.mavlink import telemetry
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.commands import stream_request
from companion.mavlink.dialect import DIALECTS, Dialect, autopilot_kind, describe_heartbeat
from companion.mavlink.signing import SIGNATURE_CODES, SigningKey
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code
from companion.types.requests import AttitudeTarget, AutopilotRequest
from companion.types.telemetry import ModeSample, ParameterSample, Telemetry, ThrustSample

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1
THRUST_DECIMALS = 5


class Translator:
    """Receives only from the autopilot of system id `vehicle_id`; sends as onboard computer of the same system.

    `autopilot` selects the dialect. Where it is None the first HEARTBEAT does, and nothing can be sent before. A HEARTBEAT of
    another make is refused.
    """

    def __init__(self, vehicle_id: int, autopilot: AutopilotKind | None = None, key: SigningKey | None = None) -> None:
        self._system_id = vehicle_id
        self._codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, key)
        self._relay_codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._has_key = key is not None
        self._texts = telemetry.TextAssembler()
        self.rejected: Counter[str] = Counter()  # damaged or implausible packets, by code
        self.other_systems: set[int] = set()  # received system ids other than the own one
        self.refused_signature: Code | None = None  # of the last packet with a refused signature
        self.lacks_key = False  # the autopilot signs, and this agent has no key
        self._autopilot = autopilot
        self.refused_heartbeat = ""  # reason for the last refused HEARTBEAT

    @property
    def dialect(self) -> Dialect:
        """Dialect of the autopilot. Raises LookupError before its make is known."""
        if self._autopilot is None:
            raise LookupError("no HEARTBEAT yet: the make of the autopilot is unknown")
        return DIALECTS[self._autopilot]

    def telemetry(self, data: bytes, received_s: float) -> list[Telemetry]:
        """All samples in these bytes, in order."""
        samples: list[Telemetry] = []
        for message in self._codec.decode(data):
            if message.get_srcSystem() != self._system_id:
                self.other_systems.add(message.get_srcSystem())
            elif message.get_srcComponent() == AUTOPILOT:
                self.lacks_key = not self._has_key and bool(message.get_header().incompat_flags)
                samples += self._samples(message, received_s)
        if refused := self._codec.refused:
            self.rejected.update(refused)
            self.refused_signature = next((code for code in SIGNATURE_CODES if code in refused), self.refused_signature)
            refused.clear()
        return samples

    @property
    def packets(self) -> list[bytes]:
        """Accepted packets of the last bytes, unchanged, including those of other systems and components."""
        return self._codec.packets

    def _samples(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        match message.get_type():
            case "LOCAL_POSITION_NED":
                return [telemetry.position(message, received_s)]
            case "ATTITUDE_QUATERNION":
                attitude = telemetry.attitude(message, received_s)
                if attitude is None:
                    self.rejected[Code.ATTITUDE_INVALID] += 1
                    return []
                return [attitude]
            case "CURRENT_MODE":
                return [self._mode(message, received_s)] if self._autopilot else []
            case "HEARTBEAT":
                return self._heartbeat(message, received_s)
            case "EXTENDED_SYS_STATE":
                return [telemetry.landed(message, received_s)]
            case "ATTITUDE_TARGET":
                return [self._thrust(message, received_s)] if self._autopilot else []
            case "GPS_GLOBAL_ORIGIN":
                return [telemetry.origin(message, received_s)]
            case "SYS_STATUS":
                return [telemetry.system(message, received_s)]
            case "PARAM_VALUE":
                return self._parameter(message, received_s)
            case "GLOBAL_POSITION_INT":
                return [telemetry.global_position(message, received_s)]
            case "ESTIMATOR_STATUS":
                return [telemetry.estimator_status(message, received_s)]
            case "GPS_RAW_INT" if self._autopilot and mavlink.MAVLINK_MSG_ID_GPS_RAW_INT in self.dialect.STREAMS_US:
                return [telemetry.gps_error(message, received_s)]
            case "COMMAND_ACK":
                if message.target_system not in (0, self._system_id):
                    return []  # addressed to a ground station on the same link
                return [telemetry.acknowledgement(message, received_s)]
            case "STATUSTEXT":
                text = self._texts.add(message, received_s)
                return [text] if text else []
        return []

    def _heartbeat(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        kind = autopilot_kind(message)
        if kind is None or self._autopilot not in (None, kind):
            self.refused_heartbeat = f"HEARTBEAT reports {describe_heartbeat(message)}, expected {self._expected()}"
            self.rejected[Code.AUTOPILOT_OTHER_MAKE] += 1
            return []
        self._autopilot = kind
        return [telemetry.heartbeat(message, kind, received_s), self._mode(message, received_s)]

    def _expected(self) -> str:
        expected = [DIALECTS[self._autopilot]] if self._autopilot else list(DIALECTS.values())
        return " or ".join(f"{dialect.MAV_AUTOPILOT} ({dialect.NAME})" for dialect in expected)

    def _parameter(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        if self._autopilot is None:
            return []
        value = self.dialect.parameter_value(message)
        if not isfinite(value):
            self.rejected[Code.PARAMETER_NOT_FINITE] += 1
            return []
        return [ParameterSample(received_s, message.param_id, value)]

    def _mode(self, message: MavlinkMessage, received_s: float) -> ModeSample:
        return ModeSample(received_s, *self.dialect.mode_of(message.custom_mode))

    def _thrust(self, message: MavlinkMessage, received_s: float) -> ThrustSample:
        return ThrustSample(received_s, round(self.dialect.commanded_thrust(message), THRUST_DECIMALS))

    def attitude_target(self, target: AttitudeTarget, now_s: float) -> bytes:
        """SET_ATTITUDE_TARGET with attitude and thrust; `now_s` becomes its time_boot_ms."""
        euler_ned = euler_ned_from_enu(target.roll_rad, target.pitch_rad, target.yaw_rad)
        return self._codec.encode(
            mavlink.MAVLink_set_attitude_target_message(
                int(now_s * 1000.0) & 0xFFFFFFFF,
                self._system_id,
                AUTOPILOT,
                self.dialect.ATTITUDE_TYPE_MASK,
                quaternion_from_euler(*euler_ned),
                0.0,
                0.0,
                0.0,
                self.dialect.thrust_of(target),
            )
        )

    def request(self, request: AutopilotRequest) -> bytes:
        """The MAVLink packet of a request."""
        return self._codec.encode(self.dialect.command_for(request, self._system_id))

    def relayed(self, data: bytes) -> list[bytes]:
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

    def stream_requests(self) -> list[bytes]:
        """Requests for the message intervals of the dialect (MAV_CMD_SET_MESSAGE_INTERVAL)."""
        return [
            self._codec.encode(stream_request(self._system_id, message_id, interval_us))
            for message_id, interval_us in self.dialect.STREAMS_US.items()
        ]
