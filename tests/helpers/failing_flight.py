"""A control loop in virtual time, with an autopilot of either make and a stage that can be made to fail."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass, field
from typing import Any

from companion.link.control_loop import ControlLoop
from companion.link.systemd import Notifier
from companion.link.tick import TickTrigger
from companion.mavlink.codec import MavlinkMessage
from companion.recording.recorder import Recorder
from companion.types.autopilot import AttitudeTarget, AutopilotKind, AutopilotRequest, Telemetry
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.flight import FlightPhase
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import NetworkState
from companion.wire.messages import StatusReport, encode
from companion.wire.peer import decode_peer, encode_peer
from profile_flight import HOLD, Autopilot, Flight

PERIOD_S = 0.02


class Fault(Exception):  # noqa: N818
    """The injected exception."""


@dataclass
class AutopilotByBytes:
    """The autopilot's end of the loop: real MAVLink in both directions, no socket."""

    flight: Flight
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

    def receive_early(self, _now_s: float) -> None:
        """Nothing arrives."""

    def receive(self, _now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]:
        commands, self.commands = self.commands, ()
        return (), commands

    def traffic(self, _now_s: float) -> tuple[ReceivedTraffic, ...]:
        return ()

    def targets(self, _now_s: float) -> tuple[ReceivedTarget, ...]:
        return ()

    def publish_peer(self, packet: PeerPacket) -> None:
        received = decode_peer(encode_peer(packet))
        self.packets.append(ReceivedPeerPacket(packet.sent_s, received))
        self.published_before.append(self.sent())

    def receive_slowly(self, distant_ids: Collection[int]) -> None:
        assert not distant_ids  # a small fleet

    def publish_status(self, report: StatusReport) -> None:
        encode(report)
        self.reports.append(report)

    def reply(self, replies: Iterable[CommandReply]) -> None:
        self.replies += replies


class FailingFlight:
    """Tick by tick, as `ControlLoop.run` does it. `failed_s` is the time of the failure, `ended_s` that of the hand-over."""

    def __init__(self, kind: AutopilotKind, recorder: Recorder | None = None) -> None:
        self._flight = Flight(kind)
        self.kind = kind
        self.autopilot: Autopilot = self._flight.autopilot
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
        self.link.telemetry += tuple(self.translator.telemetry(self.autopilot.send(), self.now_s))
        self.peers.commands = tuple(Command(name, self._flight.next_number(), "anna@ground", 1) for name in names)
        if self.failed_s is not None:
            ended = self.loop.hand_over(self.now_s)
        else:
            try:
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
        self.ticks(0.2)
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
