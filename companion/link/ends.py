"""What the control loop uses of its links."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Protocol

from companion.types.autopilot import AttitudeTarget, AutopilotRequest, Telemetry
from companion.types.commands import Command, CommandReply
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import NetworkState
from companion.wire.ground import StatusReport


class AutopilotEnd(Protocol):
    """The part of `AutopilotLink` that a tick uses."""

    @property
    def is_connected(self) -> bool: ...

    def drain(self) -> tuple[Telemetry, ...]: ...

    def command(self, target: AttitudeTarget, now_s: float) -> None: ...

    def request(self, requests: Iterable[AutopilotRequest]) -> None: ...


class PeerEnd(Protocol):
    """The part of `ZenohLink` that a tick uses."""

    @property
    def network(self) -> NetworkState: ...

    @property
    def is_open(self) -> bool: ...

    def receive_early(self, now_s: float) -> None: ...

    def receive(self, now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]: ...

    def targets(self, now_s: float) -> tuple[ReceivedTarget, ...]: ...

    def traffic(self, now_s: float) -> tuple[ReceivedTraffic, ...]: ...

    def publish_peer(self, packet: PeerPacket) -> None: ...

    def receive_slowly(self, distant_ids: Collection[int]) -> None: ...

    def publish_status(self, report: StatusReport) -> None: ...

    def reply(self, replies: Iterable[CommandReply]) -> None: ...
