"""Stand-in autopilots in virtual time with one link and no agent, and the equations of the rigid body once more."""

from __future__ import annotations

from dataclasses import dataclass
from math import radians, sqrt
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.types.autopilot import AutopilotKind
from companion.types.values import GRAVITY_M_S2, Vector3
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.link import ArduPilotLinkEnd
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.messages import BUILDERS
from sitl.autopilots.px4.autopilot import Px4, Px4Mode
from sitl.autopilots.px4.link import ONBOARD_RATES_HZ, Px4Receiver, Px4Schedule
from sitl.vehicle.config import Airframe, AutopilotFile, StandIn, Wind
from sitl.vehicle.control import AttitudeSetpoint
from sitl.vehicle.dynamics import ATTITUDE, State

DT_S = 0.004
HOVER = 0.49
LEVEL = AttitudeSetpoint(quaternion_from_euler(0.0, 0.0, 0.0), HOVER)


class Px4OnBytes:
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
        message.pack(mavlink.MAVLink(None, *sender))  # sets its sender
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


COPTER_DT_S = 0.004
COPTER_HOVER = 0.365
M = mavlink
STATION = (255, 190)


class CopterOnBytes:
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
        self.copter = ArduCopter(AutopilotFile(id=vehicle_id, stand_in=stand_in), COPTER_DT_S)
        self.end = ArduPilotLinkEnd(self.copter, link_id=0)
        self.client = MavlinkCodec(*STATION)
        self._reader = ardupilotmega.MAVLink(None)
        self._reader.robust_parsing = True
        self.received: list[MavlinkMessage] = []

    def fly(self, seconds: float, stream: MavlinkMessage | None = None) -> None:
        """Advance the time, with or without this message 50 times a second."""
        for step in range(round(seconds / COPTER_DT_S)):
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
    roll_deg: float = 0.0, thrust: float = COPTER_HOVER, mask: int = 7, scale: float = 1.0, target: int = 1
) -> MavlinkMessage:
    """SET_ATTITUDE_TARGET, heading north."""
    quaternion = [scale * part for part in quaternion_from_euler(radians(roll_deg), 0.0, 0.0)]
    return M.MAVLink_set_attitude_target_message(0, target, 1, mask, quaternion, 0.0, 0.0, 0.0, thrust)


@dataclass(frozen=True)
class Equations:
    """d(state)/dt of an airframe under constant commands, in free air."""

    mass_kg: float
    inertia_kg_m2: Vector3
    drag_n_per_m_s: float
    motor_lag_s: float
    thrust_n: float
    moments_n_m: Vector3
    wind_enu_m_s: Vector3

    def rate_of_change(self, state: State) -> State:
        w, x, y, z = state[ATTITUDE]
        p, q, r, force, *moments = state[10:]
        jx, jy, jz = self.inertia_kg_m2
        mx, my, mz = moments
        up = (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y))
        ax, ay, az = (
            (force * e - self.drag_n_per_m_s * (v - wind)) / self.mass_kg
            for e, v, wind in zip(up, state[3:6], self.wind_enu_m_s, strict=True)
        )
        commanded = (self.thrust_n, *self.moments_n_m)
        lag_s = self.motor_lag_s
        motors = [(c - m) / lag_s if lag_s else 0.0 for c, m in zip(commanded, (force, *moments), strict=True)]
        return (
            *state[3:6],
            ax,
            ay,
            az - GRAVITY_M_S2,
            0.5 * (-x * p - y * q - z * r),
            0.5 * (w * p + y * r - z * q),
            0.5 * (w * q - x * r + z * p),
            0.5 * (w * r + x * q - y * p),
            (mx - (jz - jy) * q * r) / jx,
            (my - (jx - jz) * r * p) / jy,
            (mz - (jy - jx) * p * q) / jz,
            *motors,
        )

    def after(self, state: State, dt_s: float, steps: int = 1) -> State:
        """The state after so many classical Runge-Kutta steps of fourth order."""
        if self.motor_lag_s == 0.0:
            state = (*state[:13], self.thrust_n, *self.moments_n_m)
        for _ in range(steps):
            k1 = self.rate_of_change(state)
            k2 = self.rate_of_change(_plus(state, 0.5 * dt_s, k1))
            k3 = self.rate_of_change(_plus(state, 0.5 * dt_s, k2))
            k4 = self.rate_of_change(_plus(state, dt_s, k3))
            slope = tuple((a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in zip(k1, k2, k3, k4, strict=True))
            state = _normalised(_plus(state, dt_s, slope))
        return state


def _plus(state: State, seconds: float, rate: State) -> State:
    return tuple(a + seconds * b for a, b in zip(state, rate, strict=True))


def _normalised(state: State) -> State:
    w, x, y, z = state[ATTITUDE]
    norm = sqrt(w * w + x * x + y * y + z * z)
    return (*state[:6], w / norm, x / norm, y / norm, z / norm, *state[10:])
