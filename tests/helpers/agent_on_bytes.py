"""The second way to make a vehicle fly: one agent on bytes. Between it and its autopilot, of either type, is real MAVLink.

`FlightOnBytes` has the agent alone; `FailingFlight` has the control loop around it, and stages that fail.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import Any

import pytest

from companion.assembly import build_agent
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember, PeerLimits
from companion.config.reference import PointReference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.link.control_loop import ControlLoop
from companion.link.systemd import Notifier
from companion.link.tick import PREPARED_S, TickTrigger
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from companion.mavlink.translator import Translator
from companion.recording.recorder import Recorder
from companion.types.autopilot import AttitudeTarget, AutopilotKind, AutopilotRequest, Telemetry
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase, Role
from companion.types.notices import Code, Notice
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import NetworkState, Status
from companion.types.tick import Inbox
from companion.wire.messages import StatusReport, decode_peer, encode, encode_peer
from tests.fuzz.plant import PARAMETERS

M, P, C = mavlink, FlightPhase, CommandName
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT
BOTH = pytest.mark.parametrize("kind", list(AutopilotKind))
MAV_AUTOPILOT = {PX4: M.MAV_AUTOPILOT_PX4, ARDUPILOT: M.MAV_AUTOPILOT_ARDUPILOTMEGA}
ORIGIN_AMSL_M = 488.0
TAKEOFF_M = 2.0
MANUAL = {PX4: 1 << 16, ARDUPILOT: 0}  # MANUAL, STABILIZE
HOLD = {PX4: 4 << 16 | 3 << 24, ARDUPILOT: 17}
IN_ORDER: dict[AutopilotKind, dict[str, int | float]] = {
    PX4: dict(PARAMETERS),
    ARDUPILOT: {
        "GUID_OPTIONS": 8,
        "ATC_ANGLE_BOOST": 1,
        "GUID_TIMEOUT": 1.0,
        "FS_GCS_ENABLE": 0,
        "FENCE_ENABLE": 1,
        "FENCE_TYPE": 7,
        "FENCE_RADIUS": 200.0,
        "FENCE_ALT_MAX": 100.0,
        "FENCE_ACTION": 1,
        "RALLY_TOTAL": 0,
        "MOT_THST_HOVER": 0.5,
    },
}
Answer = tuple[int, ...]
AHRS = M.MAV_SYS_STATUS_AHRS
ACCEPTED, FAILED = M.MAV_RESULT_ACCEPTED, M.MAV_RESULT_FAILED
TEMPORARILY_REJECTED = M.MAV_RESULT_TEMPORARILY_REJECTED


class AutopilotOnBytes:
    """Executes commands, unless `refuses` has answers for a command: it sends these and does nothing else."""

    def __init__(self, kind: AutopilotKind) -> None:
        self.kind = kind
        self.custom_mode, self.armed, self.landed, self.up_m = MANUAL[kind], False, 1, 0.0
        self.north_m_s = 0.0
        self.refuses: dict[int, Answer] = {}
        self.queued: list[MavlinkMessage] = []  # sent in the next tick
        self.withheld: tuple[str, ...] = ()
        self.parameters = dict(IN_ORDER[kind])
        self.battery_percent = 90
        self.may_arm = self.estimator_healthy = True
        self.read: list[str] = []  # names of parameters that were asked for
        self.commands: list[MavlinkMessage] = []
        self.targets: list[MavlinkMessage] = []
        self._codec = MavlinkCodec(3, 1)
        self._ticks = 0
        self.now_s = 0.0  # its clock

    def send_at(self, now_s: float) -> bytes:
        """What it sends at this time."""
        self.now_s = now_s
        return self.send()

    def send(self) -> bytes:
        """50 Hz; PX4's HEARTBEAT once a second."""
        boot_ms = round(1000 * self.now_s)
        messages, self.queued = self.queued, []
        messages.append(M.MAVLink_attitude_quaternion_message(boot_ms, 1, 0, 0, 0, 0, 0, 0))
        messages.append(M.MAVLink_extended_sys_state_message(0, self.landed))
        healthy = M.MAV_SYS_STATUS_PREARM_CHECK if self.may_arm else 0
        healthy |= AHRS if self.estimator_healthy else 0
        messages.append(
            M.MAVLink_sys_status_message(AHRS, AHRS, healthy, 0, 0, 0, self.battery_percent, 0, 0, 0, 0, 0, 0)
        )
        if self.kind is PX4:
            messages.append(M.MAVLink_current_mode_message(0, self.custom_mode, self.custom_mode))
        if self.kind is ARDUPILOT or self._ticks % 50 == 0:
            messages.append(self.heartbeat())
        if self._ticks % 50 == 0:
            at, no = (473977420, 85455940, int(ORIGIN_AMSL_M * 1000)), (0.0, 0.0, 0.0)
            messages.append(M.MAVLink_home_position_message(*at, *no, [1.0, 0.0, 0.0, 0.0], *no))
        messages.append(M.MAVLink_local_position_ned_message(boot_ms, 0, 0, -self.up_m, self.north_m_s, 0, 0))
        self._ticks += 1
        return b"".join(self._codec.encode(m) for m in messages if m.get_type() not in self.withheld)

    def heartbeat(self) -> MavlinkMessage:
        flags = M.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (M.MAV_MODE_FLAG_SAFETY_ARMED if self.armed else 0)
        return M.MAVLink_heartbeat_message(
            M.MAV_TYPE_QUADROTOR, MAV_AUTOPILOT[self.kind], flags, self.custom_mode, 4, 3
        )

    def receive(self, data: bytes) -> None:
        for message in self._codec.decode(data):
            if message.get_type() == "SET_ATTITUDE_TARGET":
                self.targets.append(message)
            elif message.get_type() == "PARAM_REQUEST_READ":
                self._send_parameter(message.param_id)
            else:
                self._command(message)

    def _send_parameter(self, name: str) -> None:
        """Integers bytewise in PX4's, as numbers in ArduPilot's. No answer for a parameter that it does not have."""
        self.read.append(name)
        if name not in self.parameters:
            return
        value = self.parameters[name]
        kind = M.MAV_PARAM_TYPE_INT32 if isinstance(value, int) else M.MAV_PARAM_TYPE_REAL32
        if isinstance(value, int) and self.kind is PX4:
            value = struct.unpack("<f", struct.pack("<i", value))[0]
        self.queued.append(M.MAVLink_param_value_message(name.encode(), value, kind, len(self.parameters), 0))

    def _command(self, message: MavlinkMessage) -> None:
        number = message.command
        if number == M.MAV_CMD_REQUEST_MESSAGE:
            self.queued.append(M.MAVLink_gps_global_origin_message(473977420, 85455940, int(ORIGIN_AMSL_M * 1000)))
            return
        self.commands.append(message)
        answers = self.refuses.get(number, (ACCEPTED,))
        self.queued += [M.MAVLink_command_ack_message(number, result) for result in answers]
        if number not in self.refuses:
            self._do(message)

    def _do(self, message: MavlinkMessage) -> None:
        match message.command:
            case M.MAV_CMD_DO_SET_MODE:
                main, sub = int(message.param2), int(message.param3)
                self.custom_mode = main << 16 | sub << 24 if self.kind is PX4 else main
            case M.MAV_CMD_COMPONENT_ARM_DISARM:
                self.armed = bool(message.param1)
            case M.MAV_CMD_NAV_TAKEOFF:
                above_m = ORIGIN_AMSL_M if self.kind is PX4 else 0.0
                self.up_m, self.landed = message.param7 - above_m, 2
                self.custom_mode = HOLD[PX4] if self.kind is PX4 else self.custom_mode


class FlightOnBytes:
    """An agent and its autopilot, tick by tick, with nothing but bytes between them."""

    def __init__(self, kind: AutopilotKind, wanted: AutopilotKind | None = None) -> None:
        member = FormationMember(id=3, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0))
        fleet = FleetConfig(
            name="one",
            origin="indoor",
            vehicles=(member,),
            neighbours=EdgeNeighbours(edges=()),
            peers=PeerLimits(full_rate_up_to=0),  # a large fleet, so that the agent has all stages
            takeoff_height_m=TAKEOFF_M,
        )
        vehicle = VehicleConfig(
            id=3,
            fleet="fleet.yaml",
            mavlink="udpin:127.0.0.1:14540",
            hover_thrust_norm=0.5,
            reference=PointReference(point_enu_m=(20.0, 0.0, TAKEOFF_M)),  # far away: it leans as far as it may
        )
        self.autopilot = AutopilotOnBytes(kind)
        self.translator = Translator(3, wanted)
        self.agent = build_agent(AgentConfig(vehicle, fleet, member), session=1)
        self.now_s = 100.0
        self.stopping = False
        self.events: list[Notice] = []
        self.status: Status | None = None  # the newest
        self.replies: list[tuple[bool, Code, str]] = []
        self._number = 0  # of the last command

    def next_number(self) -> int:
        self._number += 1
        return self._number

    def tick(self, *names: CommandName) -> None:
        self.now_s += 0.02
        telemetry = tuple(self.translator.telemetry(self.autopilot.send_at(self.now_s), self.now_s))
        commands = tuple(Command(name, self.next_number(), "anna@ground", 1) for name in names)
        outbox = self.agent.step(self.now_s, Inbox(telemetry, (), commands, self.stopping))
        if outbox.attitude_target:
            self.autopilot.receive(self.translator.attitude_target(outbox.attitude_target, self.now_s))
        for request in outbox.requests:
            self.autopilot.receive(self.translator.request(request))
        self.events += outbox.events
        self.status = outbox.status or self.status
        self.replies += [(reply.accepted, reply.code, reply.reason) for reply in outbox.replies]

    def ticks(self, seconds: float) -> None:
        for _ in range(round(seconds / 0.02)):
            self.tick()

    def do(self, name: CommandName, seconds: float = 2.0) -> FlightPhase:
        self.tick(name)
        assert self.replies[-1][0], self.replies[-1]
        self.ticks(seconds)
        return self.agent.phase

    def fly_to(self, phase: FlightPhase) -> FlightOnBytes:
        self.ticks(0.2)
        for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM):
            if self.agent.phase is not phase:
                self.do(name)
        assert self.agent.phase is phase, self.events
        return self


def asked(flight: FlightOnBytes) -> list[tuple[float, ...]]:
    """(command, the parameters that are not zero) of all COMMAND_LONGs."""
    return [
        (
            m.command,
            *(p for p in (m.param1, m.param2, m.param3, m.param4, m.param5, m.param6, m.param7) if p and p == p),
        )
        for m in flight.autopilot.commands
    ]


PERIOD_S = 0.02


class Fault(Exception):  # noqa: N818
    """The injected exception."""


@dataclass
class AutopilotByBytes:
    """The autopilot's end of the loop: real MAVLink in both directions, no socket."""

    flight: FlightOnBytes
    telemetry: tuple[Telemetry, ...] = ()
    is_connected: bool = True

    def drain(self) -> tuple[Telemetry, ...]:
        telemetry, self.telemetry = self.telemetry, ()
        return telemetry

    def command(self, target: AttitudeTarget, now_s: float) -> None:
        self.flight.autopilot.receive(self.flight.translator.attitude_target(target, now_s))

    def request(self, requests: Iterable[AutopilotRequest]) -> None:
        for request in requests:
            self.flight.autopilot.receive(self.flight.translator.request(request))


@dataclass
class RecordedPeers:
    """The network's end of the loop: what is published is encoded, and kept."""

    commands: tuple[Command, ...] = ()
    reports: list[StatusReport] = field(default_factory=list)
    replies: list[CommandReply] = field(default_factory=list)
    packets: list[ReceivedPeerPacket] = field(default_factory=list)  # as a peer receives them, without delay
    published_before: list[int] = field(default_factory=list)  # setpoints sent before each packet
    sent: Callable[[], int] = lambda: 0
    is_open = True
    network: NetworkState = field(default_factory=NetworkState)

    def receive_late(self, _now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        return ()

    def receive(self, _now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]:
        commands, self.commands = self.commands, ()
        return (), commands

    def traffic(self, _now_s: float) -> tuple[ReceivedTraffic, ...]:
        return ()

    def targets(self, _now_s: float) -> tuple[ReceivedTarget, ...]:
        return ()

    def checks(self) -> tuple[Command, ...]:
        return ()

    def publish_peer(self, packet: PeerPacket) -> None:
        received = decode_peer(encode_peer(packet))
        self.packets.append(ReceivedPeerPacket(packet.motion.sent_s, received))
        self.published_before.append(self.sent())

    def set_low_rate_peers(self, distant_ids: Collection[int]) -> None:
        assert not distant_ids  # a small fleet

    def publish_status(self, report: StatusReport) -> None:
        encode(report)
        self.reports.append(report)

    def reply(self, replies: Iterable[CommandReply]) -> None:
        self.replies += replies


class FailingFlight:
    """Tick by tick, as `ControlLoop.run` does it. `failed_s` is the time of the failure, `ended_s` that of the hand-over."""

    def __init__(self, kind: AutopilotKind, recorder: Recorder | None = None) -> None:
        self._flight = FlightOnBytes(kind)
        self.kind = kind
        self.autopilot: AutopilotOnBytes = self._flight.autopilot
        self.agent = self._flight.agent
        self.translator = self._flight.translator
        self.link = AutopilotByBytes(self._flight)
        self.peers = RecordedPeers(sent=lambda: len(self.autopilot.targets))
        self.loop = ControlLoop(self.agent, self.link, self.peers, TickTrigger(), Notifier({}), recorder)
        self.now_s = 100.0
        self.failed_s: float | None = None
        self.ended_s: float | None = None

    def tick(self, *names: CommandName) -> None:
        self.now_s += PERIOD_S
        if self.ended_s is not None:
            return
        self.link.telemetry += tuple(self.translator.telemetry(self.autopilot.send_at(self.now_s), self.now_s))
        self.peers.commands = tuple(Command(name, self._flight.next_number(), "anna@ground", 1) for name in names)
        if self.failed_s is not None:
            ended = self.loop.hand_over(self.now_s)
        else:
            try:
                self.loop.prepare(self.now_s - PREPARED_S)
                self.loop.tick(self.now_s)
            except Fault as fault:
                self.failed_s = self.now_s
                ended = self.loop.fail(fault, self.now_s)
            else:
                return
        if ended:
            self.ended_s = self.now_s

    def ticks(self, seconds: float) -> None:
        for _ in range(round(seconds / PERIOD_S)):
            self.tick()

    def fly_to(self, phase: FlightPhase) -> FailingFlight:
        self.ticks(0.6)  # until all parameters are read
        for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
            if self.agent.phase is phase:
                break
            self.tick(name)
            while self.agent.phase is not phase and self.now_s < 200.0:
                self.tick()
                if self.agent.phase in (FlightPhase.READY, FlightPhase.ARMED, FlightPhase.HOLD):
                    break
        assert self.agent.phase is phase
        return self

    def form(self) -> None:
        """Give the command; it is carried out in later ticks."""
        self.tick(CommandName.FORM)
        assert self.peers.replies[-1].accepted, self.peers.replies[-1]

    def inject(self, owner: Any, method: str, when: Callable[[], bool] = lambda: True) -> None:
        """Make a stage raise Fault from now on."""
        works = getattr(owner, method)

        def fails(*arguments: Any, **named: Any) -> Any:
            if when():
                raise Fault(method)
            return works(*arguments, **named)

        setattr(owner, method, fails)

    @property
    def holds(self) -> bool:
        """The autopilot is in its own hold mode."""
        return self.autopilot.custom_mode == HOLD[self.kind]

    @property
    def last_target(self) -> MavlinkMessage:
        return self.autopilot.targets[-1]
