"""An ArduCopter stand-in in virtual time, with a client on one of its links."""

from __future__ import annotations

from math import radians

from pymavlink.dialects.v20 import ardupilotmega

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.link import tcp_link
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.vehicle.config import Airframe, AutopilotFile, StandIn

DT_S = 0.004
HOVER = 0.365
M = mavlink
STATION = (255, 190)


class Copter:
    """An ArduCopter stand-in and a client: `send` and `command` pass bytes, as over a socket."""

    def __init__(
        self,
        armable_after_s: float = 0.0,
        airframe: Airframe = Airframe(),  # noqa: B008 -- frozen
        vehicle_id: int = 1,
        **parameters: float,
    ) -> None:
        stand_in = StandIn(
            autopilot=AutopilotKind.ARDUPILOT,
            sensors="ideal",
            armable_after_s=armable_after_s,
            airframe=airframe,
            parameters=parameters,
        )
        self.copter = ArduCopter(AutopilotFile(id=vehicle_id, stand_in=stand_in), DT_S)
        self.end = tcp_link(self.copter)
        self.client = MavlinkCodec(*STATION)
        self._reader = ardupilotmega.MAVLink(None)
        self._reader.robust_parsing = True
        self.received: list[MavlinkMessage] = []

    def fly(self, seconds: float, stream: MavlinkMessage | None = None) -> None:
        """Advance the time, with or without this message 50 times a second."""
        for step in range(round(seconds / DT_S)):
            if stream is not None and step % 5 == 0:
                self.send(stream)
            self.copter.step()
            self.copter.flight_logs.write(self.copter)
            self._decode(b"".join(self.end.due()))
            self.copter.texts.clear()

    def send(self, message: MavlinkMessage, client: MavlinkCodec | None = None) -> list[MavlinkMessage]:
        """The answers to one message."""
        before = len(self.received)
        self._decode(b"".join(self.end.receive((client or self.client).encode(message))))
        return self.received[before:]

    def _decode(self, data: bytes) -> None:
        if data:
            self.received += self._reader.parse_buffer(data) or []

    def command(self, number: int, *parameters: float, target: tuple[int, int] = (1, 1)) -> int:
        """MAV_RESULT of the only acknowledgement."""
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        answers = self.send(M.MAVLink_command_long_message(*target, number, 0, *padded))
        (ack,) = (answer for answer in answers if answer.get_type() == "COMMAND_ACK")
        assert ack.command == number
        result: int = ack.result
        return result

    def set_mode(self, number: int) -> int:
        return self.command(M.MAV_CMD_DO_SET_MODE, 1.0, number)

    def arm(self) -> int:
        return self.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)

    def interval(self, message_id: int, rate_hz: float) -> int:
        return self.command(M.MAV_CMD_SET_MESSAGE_INTERVAL, message_id, 1e6 / rate_hz)

    def take_off(self, height_m: float = 5.0) -> None:
        """Fly from power-on to hold at this height in GUIDED."""
        self.fly(0.1)
        assert self.set_mode(CopterMode.GUIDED) == M.MAV_RESULT_ACCEPTED
        assert self.arm() == M.MAV_RESULT_ACCEPTED
        assert self.command(M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height_m) == M.MAV_RESULT_ACCEPTED
        self.fly(7.0 + height_m)

    @property
    def height_m(self) -> float:
        return self.copter.quad.position_enu_m[2]

    @property
    def climb_m_s(self) -> float:
        return self.copter.quad.velocity_enu_m_s[2]

    def texts(self) -> list[str]:
        """All texts sent so far, their chunks joined."""
        whole: list[str] = []
        for message in self.messages("STATUSTEXT"):
            if message.id and message.chunk_seq:
                whole[-1] += message.text
            else:
                whole.append(message.text)
        return whole

    def messages(self, kind: str) -> list[MavlinkMessage]:
        return [message for message in self.received if message.get_type() == kind]


def attitude(
    roll_deg: float = 0.0, thrust: float = HOVER, mask: int = 7, scale: float = 1.0, target: int = 1
) -> MavlinkMessage:
    """SET_ATTITUDE_TARGET, heading north."""
    quaternion = [scale * part for part in quaternion_from_euler(radians(roll_deg), 0.0, 0.0)]
    return M.MAVLink_set_attitude_target_message(0, target, 1, mask, quaternion, 0.0, 0.0, 0.0, thrust)
