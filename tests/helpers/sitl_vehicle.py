"""A PX4 stand-in in virtual time, with one link."""

from __future__ import annotations

from typing import Any

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage, mavlink
from sitl.autopilots.px4.autopilot import Px4, Px4Mode
from sitl.autopilots.px4.link import ONBOARD_RATES_HZ, Px4Receiver, Px4Schedule
from sitl.autopilots.px4.messages import BUILDERS
from sitl.vehicle.config import Airframe, AutopilotFile, StandIn, Wind
from sitl.vehicle.control import AttitudeSetpoint

DT_S = 0.004
HOVER = 0.49
LEVEL = AttitudeSetpoint(quaternion_from_euler(0.0, 0.0, 0.0), HOVER)


class Vehicle:
    """A PX4 stand-in with one link. `send` passes a message as if received over that link."""

    def __init__(
        self,
        sensors: Any = "ideal",
        airframe: Airframe = Airframe(),  # noqa: B008 -- frozen
        wind: Wind = Wind(),  # noqa: B008 -- frozen
        seed: int = 1,
        vehicle_id: int = 1,
        **parameters: float,
    ) -> None:
        stand_in = StandIn(sensors=sensors, airframe=airframe, wind=wind, seed=seed, parameters=parameters)
        self.px4 = Px4(AutopilotFile(id=vehicle_id, stand_in=stand_in), DT_S)
        self.schedule = Px4Schedule(self.px4, ONBOARD_RATES_HZ)
        self.receiver = Px4Receiver(self.px4, self.schedule)
        self.sent: list[MavlinkMessage] = []

    def fly(self, seconds: float, stream: AttitudeSetpoint | None = None, stream_hz: float = 50.0) -> None:
        """Advance the time, with or without a setpoint stream."""
        every = round(1.0 / stream_hz / DT_S)
        for step in range(round(seconds / DT_S)):
            if stream is not None and step % every == 0:
                self.px4.take_setpoint(stream)
            self.px4.step()
            self.sent += [BUILDERS[number](self.px4) for number in self.schedule.due(self.px4.time_s)]

    def send(self, message: MavlinkMessage, sender: tuple[int, int] = (255, 190)) -> list[MavlinkMessage]:
        """The answers to one message."""
        message._header.srcSystem, message._header.srcComponent = sender
        return list(self.receiver.receive(message))

    def command(self, number: int, *parameters: float, target: tuple[int, int] = (1, 1)) -> list[MavlinkMessage]:
        padded = [*parameters, *[0.0] * (7 - len(parameters))]
        return self.send(mavlink.MAVLink_command_long_message(*target, number, 0, *padded))

    def results(self, number: int, *parameters: float, target: tuple[int, int] = (1, 1)) -> list[int]:
        """The MAV_RESULTs of a command, in order."""
        answers = self.command(number, *parameters, target=target)
        return [answer.result for answer in answers if answer.get_type() == "COMMAND_ACK"]

    def set_mode(self, mode: Px4Mode) -> list[int]:
        return self.results(mavlink.MAV_CMD_DO_SET_MODE, 1.0, *mode.value)

    def take_off(self, height_m: float = 2.5) -> None:
        """Fly from power-on to hold at this height."""
        self.fly(4.2)
        assert self.px4.arm() is None
        assert self.px4.take_off(self.altitude_amsl_m + height_m)
        self.fly(4.0 + height_m)
        assert self.px4.mode is Px4Mode.LOITER

    def offboard(self) -> None:
        """Fly from power-on to a hover in OFFBOARD."""
        self.take_off()
        self.fly(0.2, LEVEL)
        assert self.set_mode(Px4Mode.OFFBOARD) == [0, 0]
        self.fly(0.2, LEVEL)

    @property
    def altitude_amsl_m(self) -> float:
        return self.px4.quad.origin[2] + self.px4.quad.estimated_position_local_enu_m()[2]

    @property
    def height_m(self) -> float:
        """True height above the origin of the world."""
        return self.px4.quad.position_enu_m[2]

    def texts(self) -> list[str]:
        return [text for _, text in self.px4.texts]

    def messages(self, kind: str) -> list[MavlinkMessage]:
        """Messages of one type sent on the link so far."""
        return [message for message in self.sent if message.get_type() == kind]
