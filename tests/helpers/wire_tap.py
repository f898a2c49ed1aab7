"""A proxy between a stand-in and its agent: forwards packets, records their times, and can be cut."""

from __future__ import annotations

import select
import time
from dataclasses import dataclass, field

from background import Background
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink

LEVEL_WITHIN = 1e-6  # components of a quaternion


@dataclass(frozen=True)
class Setpoint:
    """One SET_ATTITUDE_TARGET."""

    at_s: float
    is_level: bool
    thrust_norm: float
    attitude: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  # quaternion, w first


@dataclass
class WireTap(Background):
    """Listens at `stand_in_port`, to which the autopilot sends, and forwards to the agent at `agent_port`.

    Times are those of reception here, by the monotonic clock. `formation_mode` is the custom mode of the autopilot in
    formation, as `mode_message` reports it.
    """

    stand_in_port: int
    agent_port: int
    formation_mode: int
    mode_message: str
    is_cut: bool = False  # drops telemetry; packets of the agent still pass
    withheld: str = ""  # name of a telemetry message that is dropped
    positions_s: list[float] = field(default_factory=list)  # forwarded to the agent
    other_modes_s: list[float] = field(default_factory=list)  # times of any mode other than that of formation
    setpoints: list[Setpoint] = field(default_factory=list)
    commands: list[MavlinkMessage] = field(default_factory=list)  # of the agent, without requests of rates and messages

    def __post_init__(self) -> None:
        super().__init__()
        self._front = self.udp_socket()
        self._front.bind(("127.0.0.1", self.stand_in_port))
        self._back = self.udp_socket()
        self._back.bind(("127.0.0.1", 0))
        self._autopilot: tuple[str, int] | None = None
        self._down, self._up = MavlinkCodec(1, 1), MavlinkCodec(1, 1)

    def setpoints_since(self, time_s: float) -> list[Setpoint]:
        return [setpoint for setpoint in self.setpoints if setpoint.at_s > time_s]

    def positions_since(self, time_s: float) -> list[float]:
        return [at_s for at_s in self.positions_s if at_s > time_s]

    def run(self) -> None:
        while not self.ended.is_set():
            readable, _, _ = select.select([self._front, self._back], [], [], 0.05)
            if self._front in readable:
                data, self._autopilot = self._front.recvfrom(4096)
                if not self.is_cut:
                    self._telemetry(data)
            if self._back in readable:
                try:
                    data = self._back.recv(4096)
                except ConnectionError:
                    continue  # no agent is running
                self._from_agent(data)

    def _telemetry(self, data: bytes) -> None:
        now_s = time.monotonic()
        messages = self._down.decode(data)  # the stand-in sends one message per packet
        if self.withheld in [message.get_type() for message in messages]:
            return
        for message in messages:
            kind = message.get_type()
            if kind == "LOCAL_POSITION_NED":
                self.positions_s.append(now_s)
            elif kind == self.mode_message and message.custom_mode != self.formation_mode:
                self.other_modes_s.append(now_s)
        self._back.sendto(data, ("127.0.0.1", self.agent_port))

    def _from_agent(self, data: bytes) -> None:
        now_s = time.monotonic()
        for message in self._up.decode(data):
            if message.get_type() == "SET_ATTITUDE_TARGET":
                is_level = max(abs(message.q[1]), abs(message.q[2])) < LEVEL_WITHIN
                self.setpoints.append(Setpoint(now_s, is_level, message.thrust, tuple(message.q)))
            elif message.get_type() == "COMMAND_LONG" and message.command not in (
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                mavlink.MAV_CMD_REQUEST_MESSAGE,
            ):
                self.commands.append(message)
        if self._autopilot:
            self._front.sendto(data, self._autopilot)
