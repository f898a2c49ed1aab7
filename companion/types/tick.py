"""Input and output of one tick of the agent, whose first part may run before the position that it waits for."""

from __future__ import annotations

from msgspec import Struct

from companion.types.autopilot import AttitudeTarget, AutopilotRequest, Telemetry
from companion.types.commands import Command, CommandReply
from companion.types.notices import Notice
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import Status


class Inbox(Struct, frozen=True, gc=False):
    """Input since the last tick. `stopping`: the process is to end, after a hand-over from formation.

    `late_s`: how much later than due this tick began, seconds. `law_s`: how long a law from outside took in the tick before,
    seconds; 0 for a built-in one, and in virtual time. The first `early` packets of `peers`, and all commands and
    targets, were there when the tick was prepared, at `prepared_s`; None where that was done with the rest.
    `checks` are commands that are answered and not executed.
    """

    telemetry: tuple[Telemetry, ...] = ()
    peers: tuple[ReceivedPeerPacket, ...] = ()
    commands: tuple[Command, ...] = ()
    stopping: bool = False
    targets: tuple[ReceivedTarget, ...] = ()
    late_s: float = 0.0
    traffic: tuple[ReceivedTraffic, ...] = ()
    prepared_s: float | None = None
    early: int = 0
    law_s: float = 0.0
    checks: tuple[Command, ...] = ()


class Outbox(Struct, frozen=True, gc=False):
    """Output of one tick. `attitude_target` is None if there is no setpoint in this tick."""

    attitude_target: AttitudeTarget | None = None
    requests: tuple[AutopilotRequest, ...] = ()
    peer_packet: PeerPacket | None = None
    status: Status | None = None
    replies: tuple[CommandReply, ...] = ()
    events: tuple[Notice, ...] = ()
    distant_ids: tuple[int, ...] = ()  # peers to receive at 5 Hz instead of 50 Hz
