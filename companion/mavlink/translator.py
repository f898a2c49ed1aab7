"""One vehicle's MAVLink: bytes -> Telemetry, Outbox -> bytes. No sockets, no clocks."""

from __future__ import annotations

from collections import Counter
from math import isfinite

from companion.frames import euler_ned_from_enu, quaternion_from_euler
from companion.mavlink import telemetry
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.commands import stream_request
from companion.mavlink.manners import MANNERS, Manners, kind_of, words_for
from companion.mavlink.signing import REASONS, SigningKey
from companion.types import (
    AttitudeTarget,
    AutopilotKind,
    AutopilotRequest,
    ModeSample,
    ParameterSample,
    Telemetry,
    ThrustSample,
)

AUTOPILOT = mavlink.MAV_COMP_ID_AUTOPILOT1


class Translator:
    """Listens to the autopilot of system id `vehicle_id` alone; speaks as the onboard computer of the same system.

    `autopilot` says whose manners it has; where it is None the first HEARTBEAT does. Until then nothing can be said to it. A
    HEARTBEAT that says otherwise is refused.
    """

    def __init__(self, vehicle_id: int, autopilot: AutopilotKind | None = None, key: SigningKey | None = None) -> None:
        self._system_id = vehicle_id
        self._codec = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER, key)
        self._beside = MavlinkCodec(vehicle_id, mavlink.MAV_COMP_ID_ONBOARD_COMPUTER)
        self._has_key = key is not None
        self._texts = telemetry.TextAssembler()
        self.rejected: Counter[str] = Counter()  # what came damaged or without sense, by reason
        self.other_systems: set[int] = set()  # system ids heard that are not ours
        self.refused_signature: str | None = None  # why a packet was last refused for its signature
        self.signs_alone = False  # the autopilot signs and this agent cannot
        self._autopilot = autopilot
        self.refused_heartbeat = ""  # why the last one that was refused was

    @property
    def manners(self) -> Manners:
        """Raises LookupError before they are known."""
        if self._autopilot is None:
            raise LookupError("no HEARTBEAT has said yet which autopilot it is")
        return MANNERS[self._autopilot]

    def telemetry(self, data: bytes, received_s: float) -> list[Telemetry]:
        """All samples in these bytes, in their order."""
        samples: list[Telemetry] = []
        for message in self._codec.decode(data):
            if message.get_srcSystem() != self._system_id:
                self.other_systems.add(message.get_srcSystem())
            elif message.get_srcComponent() == AUTOPILOT:
                self.signs_alone = not self._has_key and bool(message.get_header().incompat_flags)
                samples += self._samples(message, received_s)
        if self._codec.refused:
            self.rejected += self._codec.refused
            self.refused_signature = next(
                (why for why in REASONS if why in self._codec.refused), self.refused_signature
            )
            self._codec.refused.clear()
        return samples

    @property
    def packets(self) -> list[bytes]:
        """What the last bytes brought that was not refused, as it came: of other systems and components, too."""
        return self._codec.packets

    def _samples(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        match message.get_type():
            case "LOCAL_POSITION_NED":
                return [telemetry.position(message, received_s)]
            case "ATTITUDE_QUATERNION":
                attitude = telemetry.attitude(message, received_s)
                if attitude is None:
                    self.rejected["attitude of the autopilot that is no rotation"] += 1
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
            case "GPS_RAW_INT" if self._autopilot and mavlink.MAVLINK_MSG_ID_GPS_RAW_INT in self.manners.STREAMS_US:
                return [telemetry.gps_error(message, received_s)]
            case "COMMAND_ACK":
                if message.target_system not in (0, self._system_id):
                    return []  # to a ground station on the same link
                return [telemetry.acknowledgement(message, received_s)]
            case "STATUSTEXT":
                text = self._texts.add(message, received_s)
                return [text] if text else []
        return []

    def _heartbeat(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        kind = kind_of(message)
        if kind is None or self._autopilot not in (None, kind):
            self.refused_heartbeat = f"its HEARTBEAT says {words_for(message)}, expected {self._expected()}"
            self.rejected["HEARTBEAT of another make of autopilot"] += 1
            return []
        self._autopilot = kind
        return [telemetry.heartbeat(message, kind, received_s), self._mode(message, received_s)]

    def _expected(self) -> str:
        expected = [MANNERS[self._autopilot]] if self._autopilot else list(MANNERS.values())
        return " or ".join(f"{manners.MAV_AUTOPILOT} ({manners.NAME})" for manners in expected)

    def _parameter(self, message: MavlinkMessage, received_s: float) -> list[Telemetry]:
        if self._autopilot is None:
            return []
        value = self.manners.parameter_value(message)
        if not isfinite(value):
            self.rejected["parameter of the autopilot that is not finite"] += 1
            return []
        return [ParameterSample(received_s, message.param_id, value)]

    def _mode(self, message: MavlinkMessage, received_s: float) -> ModeSample:
        return ModeSample(received_s, *self.manners.mode_of(message.custom_mode))

    def _thrust(self, message: MavlinkMessage, received_s: float) -> ThrustSample:
        return ThrustSample(received_s, self.manners.commanded_thrust(message))

    def attitude_target(self, target: AttitudeTarget, now_s: float) -> bytes:
        """SET_ATTITUDE_TARGET with attitude and thrust; `now_s` becomes its time_boot_ms."""
        euler_ned = euler_ned_from_enu(target.roll_rad, target.pitch_rad, target.yaw_rad)
        return self._codec.encode(
            mavlink.MAVLink_set_attitude_target_message(
                int(now_s * 1000.0) & 0xFFFFFFFF,
                self._system_id,
                AUTOPILOT,
                self.manners.ATTITUDE_TYPE_MASK,
                quaternion_from_euler(*euler_ned),
                0.0,
                0.0,
                0.0,
                self.manners.thrust_of(target),
            )
        )

    def request(self, request: AutopilotRequest) -> bytes:
        """A COMMAND_LONG."""
        return self._codec.encode(self.manners.command_for(request, self._system_id))

    def relayed(self, data: bytes) -> list[bytes]:
        """Another program's messages as this link's own: signed, where it is signed."""
        return [self._codec.encode(message) for message in self._beside.decode(data)]

    def heartbeat(self) -> bytes:
        """The companion's own HEARTBEAT. Never that of a ground station: it would hide a lost one from the autopilot."""
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
        """The telemetry rates that the agent lives on (MAV_CMD_SET_MESSAGE_INTERVAL)."""
        return [
            self._codec.encode(stream_request(self._system_id, message_id, interval_us))
            for message_id, interval_us in self.manners.STREAMS_US.items()
        ]
