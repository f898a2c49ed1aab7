"""One agent process on a real wire: autopilots without physics, or a stand-in process behind a tap. Each runs in a thread."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Self

import pytest

from common import until
from companion.ground.session import FleetSession
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, SigningKey, mavlink
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.notices import Notice
from companion.types.status import Status
from processes import AgentFiles, StandInProcess, agent_files, stand_in
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


LEVEL_WITHIN = 1e-6  # components of a quaternion


@dataclass(frozen=True)
class Setpoint:
    """One SET_ATTITUDE_TARGET: received `at_s`, and decided `decided_s` by the agent's clock."""

    at_s: float
    decided_s: float
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
                decided_s = message.time_boot_ms / 1000.0
                self.setpoints.append(Setpoint(now_s, decided_s, is_level, message.thrust, tuple(message.q)))
            elif message.get_type() == "COMMAND_LONG" and message.command not in (
                mavlink.MAV_CMD_SET_MESSAGE_INTERVAL,
                mavlink.MAV_CMD_REQUEST_MESSAGE,
            ):
                self.commands.append(message)
        if self._autopilot:
            self._front.sendto(data, self._autopilot)


UNDER_WAY = 2  # setpoints that may already be on their way
ENDS = 1  # the last one before a silence, which brakes


CLIMBED_M = 1.0


@dataclass(frozen=True)
class AutopilotCase:
    """What differs between the autopilots."""

    stand_in: str
    formation_mode: int
    mode_message: str
    formation_mode_name: str
    hold_mode: int  # modes of DO_SET_MODE
    hold_mode_name: str
    pilots_mode: tuple[int, int]
    hover_thrust_norm: float
    leaves_formation_by_itself: bool  # without setpoints


# A PX4 without its stream changes to Hold after a second, as the README advises.
PX4 = AutopilotCase(
    stand_in="{armable_after_s: 1, sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]}, parameters: {COM_OBL_RC_ACT: 5}}",
    formation_mode=6 << 16,
    mode_message="CURRENT_MODE",
    formation_mode_name="OFFBOARD",
    hold_mode=4,
    hold_mode_name="LOITER",
    pilots_mode=(4, 3),
    hover_thrust_norm=0.49,
    leaves_formation_by_itself=True,
)


ARDUPILOT = AutopilotCase(
    stand_in="{autopilot: ardupilot, armable_after_s: 1, sensors: ideal, wind: {mean_enu_m_s: [3.0, 0.0, 0.0]},"
    " parameters: {GUID_OPTIONS: 8}}",
    formation_mode=4,
    mode_message="HEARTBEAT",
    formation_mode_name="GUIDED",
    hold_mode=17,
    hold_mode_name="BRAKE",
    pilots_mode=(5, 0),
    hover_thrust_norm=0.365,
    leaves_formation_by_itself=False,
)


@dataclass
class TappedFlight:
    """One flying vehicle with all its processes and a ground session."""

    make: AutopilotCase
    files: AgentFiles
    stand_in: StandInProcess
    tap: WireTap
    session: FleetSession
    status: Status | None = None

    @property
    def phase(self) -> FlightPhase | None:
        for report in self.session.drain():
            self.status = report.status
        return self.status.phase if self.status else None

    def forget_reports(self) -> None:
        """Forget the status and all reports that wait to be read."""
        for _ in self.session.drain():
            pass
        self.status = None

    def newest_event(self) -> Notice | None:
        """Of the newest status that has arrived."""
        return self.status.last_event if self.phase is not None and self.status else None

    def order(self, name: CommandName, phase: FlightPhase) -> None:
        """Repeat a command until the vehicle is in that phase."""

        def reached() -> bool:
            if self.phase is not phase:
                self.session.command([1], name, 1.0)
            end_s = time.monotonic() + 1.0
            while self.phase is not phase and time.monotonic() < end_s:
                time.sleep(0.02)
            return self.phase is phase

        until(reached, 60.0)

    def form(self) -> None:
        """From any state into FORMATION, with half a second of setpoints."""
        self.tap.is_cut, self.tap.withheld = False, ""
        for name, phase in (
            (CommandName.PREPARE, FlightPhase.READY),
            (CommandName.ARM, FlightPhase.ARMED),
            (CommandName.TAKEOFF, FlightPhase.HOLD),
        ):
            if (row := self.stand_in.newest) is None or row.z_m < CLIMBED_M:
                self.order(name, phase)
        if self.phase is not FlightPhase.FORMATION:
            self.order(CommandName.HOLD, FlightPhase.HOLD)
            self.order(CommandName.FORM, FlightPhase.FORMATION)
        start_s = time.monotonic()
        until(lambda: len(self.tap.setpoints_since(start_s)) > 25)

    def observes_and_sends_nothing(self, seconds: float) -> None:
        """Neither setpoints nor commands in this time; a PX4, which would follow a stream, keeps its mode."""
        start_s, commands = time.monotonic(), len(self.tap.commands)
        time.sleep(seconds)
        assert self.phase is FlightPhase.OBSERVE
        assert self.tap.setpoints_since(start_s) == []
        assert self.tap.commands[commands:] == []
        assert len(self.tap.positions_since(start_s)) > 10  # it had positions
        assert self.stand_in.newest.mode != "OFFBOARD"  # type: ignore[union-attr]

    def is_silent(self, since_s: float) -> bool:
        """No setpoint since then except those on their way and the last one before the silence, which hovers."""
        assert self.tap.setpoints[-1].thrust_norm == pytest.approx(self.make.hover_thrust_norm, rel=0.1)
        return len(self.tap.setpoints_since(since_s)) <= UNDER_WAY + ENDS


@contextmanager
def in_the_air(folder: Path, make: AutopilotCase) -> Iterator[TappedFlight]:
    with stand_in(folder, f"id: 1\nstand_in: {make.stand_in}\n") as autopilot:
        files = agent_files(folder)
        text = files.file.read_text(encoding="utf-8")
        own = text.replace("hover_thrust_norm: 0.49", f"hover_thrust_norm: {make.hover_thrust_norm}")
        files.file.write_text(own, encoding="utf-8")
        with (
            WireTap(autopilot.ports.companion, files.udp_port, make.formation_mode, make.mode_message) as tap,
            FleetSession("processtest", (files.zenoh,)) as session,
        ):
            yield TappedFlight(make, files, autopilot, tap, session)
