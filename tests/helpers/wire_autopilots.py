"""Threads with UDP sockets beside the process under test: autopilots without physics, and a tap on the wire."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from random import Random
from types import TracebackType
from typing import Self

from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, SigningKey, mavlink
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.logs import FlightLog
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn
from tests.fuzz.plant import PARAMETERS


class Background:
    """`run` must return when `ended` is set. Sockets from `udp_socket` are closed after it."""

    def __init__(self) -> None:
        self.ended = threading.Event()
        self._thread = threading.Thread(target=self.run)
        self._sockets: list[socket.socket] = []

    def udp_socket(self) -> socket.socket:
        self._sockets.append(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        return self._sockets[-1]

    def run(self) -> None:
        raise NotImplementedError

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.ended.set()
        self._thread.join()
        for opened in self._sockets:
            opened.close()


PERIOD_S = 0.02
LOITER, OFFBOARD = (4, 3), (6, 0)
HOVER_THRUST_NORM = 0.49
IN_ORDER = {name: float(value) for name, value in PARAMETERS.items()} | {"MPC_THR_HOVER": HOVER_THRUST_NORM}


@dataclass
class HoveringAutopilot(Background):
    """Sends to `port` of this machine. Attributes may be changed while it runs."""

    vehicle_id: int
    port: int
    autopilot: int = mavlink.MAV_AUTOPILOT_PX4
    positions: bool = True  # LOCAL_POSITION_NED at 50 Hz
    accepts_modes: bool = True
    mode: tuple[int, int] = LOITER
    key: SigningKey | None = None
    parameters: dict[str, float] = field(
        default_factory=IN_ORDER.copy
    )  # reported as floats; requests of others get no answer
    target_times_s: list[float] = field(default_factory=list)
    thrusts: list[float] = field(default_factory=list)  # of the setpoints at those times
    received: list[MavlinkMessage] = field(default_factory=list)  # all but SET_ATTITUDE_TARGET

    def __post_init__(self) -> None:
        super().__init__()
        self._socket = self.udp_socket()
        self._socket.setblocking(False)
        self._codec = MavlinkCodec(self.vehicle_id, mavlink.MAV_COMP_ID_AUTOPILOT1, self.key)

    def inject(self, data: bytes) -> None:
        """Send bytes from the address of this autopilot."""
        self._socket.sendto(data, ("127.0.0.1", self.port))

    def commands(self, number: int) -> list[MavlinkMessage]:
        """The received COMMAND_LONGs of this number."""
        return [m for m in self.received if m.get_type() == "COMMAND_LONG" and m.command == number]

    def run(self) -> None:
        start_s, count = time.monotonic(), 0
        while not self.ended.wait(max(0.0, start_s + count * PERIOD_S - time.monotonic())):
            for message in self._outgoing(int((time.monotonic() - start_s) * 1000), count):
                self._socket.sendto(self._codec.encode(message), ("127.0.0.1", self.port))
            self._listen()
            count += 1

    def _outgoing(self, boot_ms: int, count: int) -> list[MavlinkMessage]:
        main, sub = self.mode
        custom_mode = main << 16 | sub << 24
        messages = [
            mavlink.MAVLink_attitude_quaternion_message(boot_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
            mavlink.MAVLink_current_mode_message(0, custom_mode, custom_mode),
            mavlink.MAVLink_attitude_target_message(boot_ms, 7, [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, HOVER_THRUST_NORM),
        ]
        if count % 10 == 0:
            armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            messages += [
                mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, self.autopilot, armed, custom_mode, 4, 3),
                mavlink.MAVLink_extended_sys_state_message(0, mavlink.MAV_LANDED_STATE_IN_AIR),
                mavlink.MAVLink_sys_status_message(0, 0, 0, 0, 0, 0, 90, 0, 0, 0, 0, 0, 0),
                mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488000),
            ]
        if self.positions:
            messages.append(mavlink.MAVLink_local_position_ned_message(boot_ms, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0))
        return messages

    def _listen(self) -> None:
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # no receiver yet
            for message in self._codec.decode(data):
                self._take(message)

    def _take(self, message: MavlinkMessage) -> None:
        if message.get_type() == "SET_ATTITUDE_TARGET":
            self.target_times_s.append(time.monotonic())
            self.thrusts.append(message.thrust)
            return
        self.received.append(message)
        if message.get_type() == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            self._report_parameter(message.param_id)
        is_mode = message.get_type() == "COMMAND_LONG" and message.command == mavlink.MAV_CMD_DO_SET_MODE
        if is_mode and self.accepts_modes:
            self.mode = (int(message.param2), int(message.param3))

    def _report_parameter(self, name: str) -> None:
        value = mavlink.MAVLink_param_value_message(
            name.encode(), self.parameters[name], mavlink.MAV_PARAM_TYPE_REAL32, len(self.parameters), 0
        )
        self._socket.sendto(self._codec.encode(value), ("127.0.0.1", self.port))


WRITTEN_UTC_S = 1_790_000_000  # 2026-09-21 14:13:20 UTC


@dataclass
class LoggingAutopilot(Background):
    """Vehicle 1, sending to `port` of this machine. `loss` is the share of packets lost in each direction."""

    kind: AutopilotKind
    port: int
    logs: Sequence[bytes]
    loss: float = 0.0
    utc_at_start_s: float = WRITTEN_UTC_S
    lost_entries: int = 0  # this many LOG_ENTRYs are lost first
    armed: bool = False
    arms_after_packets: float = float("inf")  # of LOG_DATA
    silent_after_packets: float = float("inf")
    received: list[MavlinkMessage] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()
        file = AutopilotFile(id=1, stand_in=StandIn(autopilot=self.kind, sensors="ideal", armable_after_s=0.0))
        self._autopilot = AUTOPILOT_TYPES[self.kind].vehicle(file, DT_S)
        self._autopilot.flight_logs.utc_at_start_s = self.utc_at_start_s
        self._autopilot.flight_logs.files = [FlightLog(bytearray(log), 60.0 * i) for i, log in enumerate(self.logs)]
        self._end = AUTOPILOT_TYPES[self.kind].onboard_link(self._autopilot)
        self._client = MavlinkCodec(255, 190)  # decodes received packets
        self._lottery = Random(4)
        self._data_packets = 0
        self._socket = self.udp_socket()
        self._socket.setblocking(False)

    def requests(self, kind: str) -> list[MavlinkMessage]:
        """The received messages of this type."""
        return [message for message in self.received if message.get_type() == kind]

    def run(self) -> None:
        next_s = time.monotonic()
        while not self.ended.wait(max(0.0, next_s - time.monotonic())):
            next_s = max(next_s + DT_S, time.monotonic() - 10 * DT_S)
            self._listen()
            self._autopilot.step()
            self._autopilot.flight_logs.write(self._autopilot)
            self._autopilot.armed = self.armed or self._data_packets > self.arms_after_packets
            for packet in self._end.due():
                self._send(packet)
            self._autopilot.texts.clear()

    def _listen(self) -> None:
        while True:
            try:
                data = self._socket.recv(4096)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # no receiver yet
            if self._lottery.random() < self.loss:
                continue
            self.received += self._client.decode(data)
            for answer in self._end.receive(data):
                self._send(answer)

    def _send(self, packet: bytes) -> None:
        self._data_packets += packet[7] == mavlink.MAVLINK_MSG_ID_LOG_DATA
        if packet[7] == mavlink.MAVLINK_MSG_ID_LOG_ENTRY and self.lost_entries:
            self.lost_entries -= 1
            return
        if self._data_packets > self.silent_after_packets or self._lottery.random() < self.loss:
            return
        try:
            self._socket.sendto(packet, ("127.0.0.1", self.port))
        except (BlockingIOError, ConnectionError):
            return  # lost


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
