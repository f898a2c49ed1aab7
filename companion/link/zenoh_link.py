"""An agent's side of Zenoh: peers, commands and targets in, peer packets, replies and status out.

Rings that the control loop drains at each tick: no thread of Zenoh's ever crosses into the loop, and nothing waits for a
loop that hangs.
"""

from __future__ import annotations

import contextlib
import time
from collections import deque
from collections.abc import Callable, Iterable

import zenoh

from companion.config.fleet import FleetConfig
from companion.config.vehicle import ZenohEndpoints
from companion.link.log import CommandLog
from companion.link.zenoh_session import drain, open_session
from companion.types import Command, CommandName, CommandReply, PeerPacket, ReceivedPeerPacket, ReceivedTarget
from companion.wire.ground import StatusReport, decode_command, encode
from companion.wire.keys import command_key, every_peer, every_target, peer_key, status_key
from companion.wire.peer import decode_peer, encode_peer
from companion.wire.target import decode_target
from companion.wire.version import WireError

PACKETS_KEPT_PER_VEHICLE = 8
COMMANDS_KEPT = 32
TARGETS_KEPT = 32
LONG_PAUSE_S = 0.1  # five ticks
# They end a formation; nobody is endangered when they come late.
OBEYED_LATE = (CommandName.HOLD, CommandName.LAND, CommandName.ABORT)


class ZenohLink:
    """What one vehicle says and hears over Zenoh. Close it on every path, else the process may hang at its exit.

    `reject` is called with the reason for every message that is refused here.
    """

    def __init__(
        self, vehicle_id: int, fleet: FleetConfig, endpoints: ZenohEndpoints, reject: Callable[[str], None]
    ) -> None:
        """Raises EndpointError. Vehicles that are not there yet are waited for in the background."""
        self._vehicle_id = vehicle_id
        self._fleet_name = fleet.name
        self._fleet_ids = frozenset(member.id for member in fleet.vehicles)
        self._reject = reject
        self._drained_s: float | None = None
        self._open_queries: deque[tuple[Command, zenoh.Query]] = deque(maxlen=COMMANDS_KEPT)
        self._log = CommandLog()
        self._session = open_session(endpoints.listen, endpoints.connect)
        self._packets_kept = PACKETS_KEPT_PER_VEHICLE * len(fleet.vehicles)
        with contextlib.ExitStack() as undo:
            undo.callback(self._session.close)
            self._declare(vehicle_id, fleet)
            undo.pop_all()

    def _declare(self, vehicle_id: int, fleet: FleetConfig) -> None:
        self._peers = self._session.declare_subscriber(
            every_peer(fleet.name),
            zenoh.handlers.RingChannel(self._packets_kept),
            allowed_origin=zenoh.Locality.REMOTE,
        )
        may_lead = any(member.id == vehicle_id and member.can_lead for member in fleet.vehicles)
        self._targets = (
            self._session.declare_subscriber(every_target(fleet.name), zenoh.handlers.RingChannel(TARGETS_KEPT))
            if may_lead
            else None
        )
        self._command_key = command_key(fleet.name, vehicle_id)
        self._commands = self._session.declare_queryable(
            self._command_key, zenoh.handlers.RingChannel(COMMANDS_KEPT), complete=True
        )
        self._peer_publisher = self._session.declare_publisher(
            peer_key(fleet.name, vehicle_id),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._status_publisher = self._session.declare_publisher(
            status_key(fleet.name, vehicle_id),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA,
        )

    def receive(self, now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]:
        """All peer packets and commands since the last call. Never blocks.

        How long a packet has waited here shows in its time of sending. After a pause of this process nobody knows how long a
        command has, which its giver may have thought lost: it is refused, but for those in OBEYED_LATE.
        """
        before_s, self._drained_s = self._drained_s, now_s
        paused = before_s is not None and now_s - before_s > LONG_PAUSE_S
        packets = (self._packet(sample) for sample in drain(self._peers, self._packets_kept))
        commands = (self._command(query, paused) for query in drain(self._commands, COMMANDS_KEPT))
        return (
            tuple(ReceivedPeerPacket(now_s, packet) for packet in packets if packet),
            tuple(command for command in commands if command),
        )

    def targets(self, now_s: float) -> tuple[ReceivedTarget, ...]:
        """What was told of targets since the last call, for one that may lead. Never blocks."""
        if self._targets is None:
            return ()
        targets = (self._target(sample, now_s) for sample in drain(self._targets, TARGETS_KEPT))
        return tuple(target for target in targets if target)

    def publish_peer(self, packet: PeerPacket) -> None:
        self._peer_publisher.put(encode_peer(packet))

    def publish_status(self, report: StatusReport) -> None:
        self._status_publisher.put(encode(report))

    def reply(self, replies: Iterable[CommandReply]) -> None:
        """Answer the queries that brought the commands, in their order. One without a query is nobody's and goes nowhere."""
        for reply in replies:
            for command, query in self._open_queries:
                if command.number == reply.number:
                    self._answer(query, reply, command)
                    self._open_queries.remove((command, query))
                    break

    def close(self) -> None:
        self._session.close()  # type: ignore[no-untyped-call]

    def _packet(self, sample: zenoh.Sample) -> PeerPacket | None:
        try:
            packet = decode_peer(sample.payload.to_bytes())
        except WireError as error:
            self._reject(str(error))
            return None
        # Compared as text: a stranger's key may end in anything, thousands of digits among it.
        if str(sample.key_expr) != peer_key(self._fleet_name, packet.vehicle_id):
            self._reject("peer packet of another vehicle than its key says")
            return None
        if packet.vehicle_id not in self._fleet_ids:  # one reason for all of them: strangers cannot fill the counters
            self._reject("peer packet of a vehicle that is not in the fleet file")
            return None
        return packet

    def _target(self, sample: zenoh.Sample, now_s: float) -> ReceivedTarget | None:
        try:
            return ReceivedTarget(
                now_s, str(sample.key_expr).rpartition("/")[2], decode_target(sample.payload.to_bytes())
            )
        except WireError as error:
            self._reject(str(error))
            return None

    def _command(self, query: zenoh.Query, paused: bool) -> Command | None:
        try:
            command = decode_command(query.payload.to_bytes() if query.payload else b"")
        except WireError as error:
            self._reject(str(error))
            self._answer(query, CommandReply(self._vehicle_id, 0, False, f"refused: {error}"))
            return None
        if paused and command.name not in OBEYED_LATE:
            reason = "came while this agent was paused; give it again"
            self._answer(query, CommandReply(self._vehicle_id, command.number, False, reason), command)
            return None
        self._open_queries.append((command, query))
        return command

    def _answer(self, query: zenoh.Query, reply: CommandReply, command: Command | None = None) -> None:
        """Dropping the query tells the asker that no more will come. `command` is None where it was none."""
        if command:
            self._log.answered(command, reply, time.monotonic())
        with contextlib.suppress(zenoh.ZError):  # the asker has gone
            query.reply(self._command_key, encode(reply), express=True)
        query.drop()  # type: ignore[no-untyped-call]
