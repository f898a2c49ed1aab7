"""Zenoh link of an agent: peer packets, commands, targets and poses in; peer packets, replies and status out.

The control loop drains ring channels shortly before each tick, and the peers' again in it, where little is left to decode. So
no Zenoh thread enters the loop, and nothing waits for a loop that hangs; poses alone are taken when they arrive. Whatever is
sent is a publication that is dropped where the network is congested (CongestionControl.DROP: a call takes 1.4 ms at most).
Commands are no queries, because a reply to a query blocks the whole process for seconds where the client reads nothing:
Zenoh's `query.reply` waits with the interpreter locked.
"""

from __future__ import annotations

import asyncio
import contextlib
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Collection, Iterable, Sequence
from typing import TYPE_CHECKING, Literal, TypeVar

import zenoh

from companion.config.fleet import FleetConfig
from companion.config.vehicle import ZenohEndpoints
from companion.link.fleet.peer_datagrams import Pairing
from companion.link.fleet.peer_states import PeerStates
from companion.link.fleet.zenoh_session import drain, each, open_session, publisher, subscriber
from companion.link.log import CHECK, COMMAND, CommandLog
from companion.link.tick import monotonic_s
from companion.security.names import ParticipantRole, parse_common_name
from companion.types.commands import Command, CommandName, CommandReply
from companion.types.notices import Code
from companion.types.peers import BodyPose, PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import NetworkState
from companion.wire.keys import (
    ANY,
    abort_key,
    admission_key,
    check_key,
    command_key,
    pose_key,
    pose_source_of,
    reply_key,
    status_key,
    target_key,
    target_of,
    traffic_key,
    traffic_of,
)
from companion.wire.messages import (
    StatusReport,
    WireError,
    decode_command,
    decode_pose,
    decode_target,
    decode_traffic,
    encode,
)

if TYPE_CHECKING:
    from companion.link.fleet.peer_datagrams import PeerDatagrams
    from companion.link.fleet.term_proofs import TermProofs
    from companion.security.admission import Admitted
    from companion.security.identity import Identity

COMMANDS_KEPT = 32
CHECKS_KEPT = 8  # between two ticks: each is answered in the next one, or begins to be judged
ABORTS_KEPT = 4  # ABORT is idempotent: more of them say nothing more
# Samples on the abort key between two ticks. All are read, and what is no ABORT is dropped before it can displace one.
ABORT_SAMPLES_KEPT = 256
LONGEST_ABORT = 512  # bytes; a longer message, or one without this text, is dropped without decoding
ABORT_TEXT = CommandName.ABORT.encode()
UNANSWERED_KEPT = 2 * COMMANDS_KEPT  # commands whose reply is not logged yet; a check may take several ticks
TARGETS_KEPT = 32
POSES_KEPT = 16  # until the event loop takes them
TRAFFIC_KEPT = 32  # samples between two ticks: a flood costs no more
TRAFFIC_NAME = re.compile("[A-Za-z0-9_-]{1,32}")
LISTS_KEPT = 2  # admission lists between two looks; the ground repeats the newest
CLOSE_WITHIN_S = 2.0
LONG_PAUSE_S = 0.1  # five ticks
# Commands that end a formation. They are safe even when they are late.
ACCEPTED_LATE = (CommandName.HOLD, CommandName.LAND, CommandName.ABORT)

Message = TypeVar("Message")


class ZenohLink:
    """Zenoh link of one vehicle. Close it on every path, else the process may hang at its exit.

    Calls `reject` with the counter's key for every refused message.
    """

    def __init__(
        self,
        vehicle_id: int,
        fleet: FleetConfig,
        endpoints: ZenohEndpoints,
        reject: Callable[[str], None],
        datagrams: PeerDatagrams | None = None,
        identity: Identity | None = None,
    ) -> None:
        """Open the session; peers that are not running yet connect later. Raises EndpointError.

        With `datagrams` peer packets are published there and received from both. With `identity` only participants that the
        fleet authority has admitted are connected, each for its own keys.
        """
        self._datagrams = datagrams
        self._vehicle_id = vehicle_id
        self._identity = identity
        # Participants that were admitted when the session began, and are no longer
        self._refused: frozenset[str] = frozenset()
        security: Literal["local", "identity", "none"] = "none" if fleet.security == "none" else "local"
        self.network = NetworkState("identity", identity.admitted.number) if identity else NetworkState(security)
        self._fleet_name = fleet.name
        self._reject = reject
        self._drained_s: float | None = None
        self._unanswered: dict[tuple[str, int], tuple[str, Command]] = {}  # what it was, and the command
        self._log = CommandLog()
        self._terms = _term_proofs(vehicle_id, fleet, identity, reject) if identity else None
        self.session = open_session(endpoints.listen, endpoints.connect, identity)
        with contextlib.ExitStack() as undo:
            undo.callback(self.close)
            self._declare(vehicle_id, fleet)
            undo.pop_all()

    def _declare(self, vehicle_id: int, fleet: FleetConfig) -> None:
        self._peers = PeerStates(self.session, vehicle_id, fleet, self._reject)
        may_lead = any(member.id == vehicle_id and member.can_lead for member in fleet.vehicles)
        self._targets = subscriber(self.session, target_key(fleet.name, ANY), TARGETS_KEPT) if may_lead else None
        self._traffic = subscriber(self.session, traffic_key(fleet.name, ANY, ANY), TRAFFIC_KEPT)
        self._commands = subscriber(self.session, command_key(fleet.name, vehicle_id, ANY), COMMANDS_KEPT)
        self._checks = subscriber(self.session, check_key(fleet.name, vehicle_id, ANY), CHECKS_KEPT)
        self._aborts = subscriber(self.session, abort_key(fleet.name, vehicle_id, ANY), ABORT_SAMPLES_KEPT)
        self._lists = subscriber(self.session, admission_key(fleet.name, ANY), LISTS_KEPT) if self._identity else None
        seal = self._datagrams.seal if self._datagrams else None
        self._pairing = Pairing(self.session, fleet.name, vehicle_id, seal) if seal else None
        interactive, usual = zenoh.Priority.INTERACTIVE_HIGH, zenoh.Priority.DATA
        self._reply_publisher = publisher(self.session, reply_key(fleet.name, vehicle_id), interactive)
        self._status_publisher = publisher(self.session, status_key(fleet.name, vehicle_id), usual, express=False)

    @property
    def is_open(self) -> bool:
        """Whether the session is open. It listens then; peers need not be connected: a lone vehicle is ready as well."""
        return not self.session.is_closed()

    def receive(self, now_s: float) -> tuple[tuple[ReceivedPeerPacket, ...], tuple[Command, ...]]:
        """All peer packets and commands since the last call. Never blocks.

        The age of a peer packet follows from its time of sending. A command has none: after a pause of this process its
        operator may consider it lost. So it is refused, except those in ACCEPTED_LATE.
        """
        if self._pairing:
            self._pairing.step(now_s)
        before_s, self._drained_s = self._drained_s, now_s
        late = before_s is not None and now_s - before_s > LONG_PAUSE_S
        aborts = self._receive_aborts()
        samples = drain(self._commands, COMMANDS_KEPT)
        commands = each(samples, lambda sample: self._command(sample, late), self._refuse(Code.COMMAND_MALFORMED))
        return self._all_packets(now_s), (*aborts, *commands)

    def _all_packets(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        packets = _received(now_s, self._peers.receive())
        if self._datagrams:
            packets += self._datagrams.receive(now_s)
        return self._judged(packets)

    def receive_late(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """Peer packets since `receive`, a few of each vehicle: those of a flood wait for the next one. Never blocks.

        After a pause of this process the first ones are too old, so it is all of them.
        """
        if self._drained_s is not None and now_s - self._drained_s > LONG_PAUSE_S:
            return self._all_packets(now_s)
        if self._datagrams:  # then peers send nothing over Zenoh, usually
            return self._judged(self._datagrams.receive_late(now_s))
        return self._judged(_received(now_s, self._peers.receive_late()))

    def _judged(self, received: tuple[ReceivedPeerPacket, ...]) -> tuple[ReceivedPeerPacket, ...]:
        return tuple(map(self._terms.judge, received)) if self._terms else received

    def targets(self, now_s: float) -> tuple[ReceivedTarget, ...]:
        """All target samples since the last call; empty for a vehicle that may not become leader. Never blocks."""
        if self._targets is None:
            return ()
        samples = drain(self._targets, TARGETS_KEPT)
        return tuple(each(samples, lambda one: self._target(one, now_s), self._refuse(Code.TARGET_MALFORMED)))

    def checks(self) -> tuple[Command, ...]:
        """Commands since the last call that are only to be answered. Never blocks. One that comes late does no harm."""
        samples = drain(self._checks, CHECKS_KEPT)
        return tuple(each(samples, self._check, self._refuse(Code.COMMAND_MALFORMED)))

    def _check(self, sample: zenoh.Sample) -> Command | None:
        if (check := self._decode_command(sample, check_key)) is not None:
            self._note(CHECK, check)
        return check

    def traffic(self, now_s: float) -> tuple[ReceivedTraffic, ...]:
        """All traffic samples since the last call. Never blocks."""
        samples = drain(self._traffic, TRAFFIC_KEPT)
        return tuple(each(samples, lambda one: self._traffic_sample(one, now_s), self._refuse(Code.TRAFFIC_MALFORMED)))

    def hear_poses(self, take: Callable[[BodyPose, float], None]) -> None:
        """From now on call `take` with each pose of this vehicle and the time of its arrival, in the running event loop.

        Zenoh's thread keeps the newest POSES_KEPT and wakes the loop once: a flood costs no more, whatever the loop does.
        """
        loop, waiting = asyncio.get_running_loop(), deque[tuple[zenoh.Sample, float]](maxlen=POSES_KEPT)

        def arrived(sample: zenoh.Sample) -> None:
            waiting.append((sample, monotonic_s()))
            if len(waiting) == 1:
                with contextlib.suppress(RuntimeError):  # the loop has ended
                    loop.call_soon_threadsafe(take_all)

        def use(arrival: tuple[zenoh.Sample, float]) -> None:
            if (pose := self._pose(arrival[0])) is not None:
                take(pose, arrival[1])

        def take_all() -> None:
            if self.session.is_closed():  # and so is what `take` sends through
                return
            for _ in range(len(waiting)):
                each((waiting.popleft(),), use, self._refuse(Code.POSE_MALFORMED))
            if waiting:  # came meanwhile, without a call
                loop.call_soon(take_all)

        self._poses = self.session.declare_subscriber(pose_key(self._fleet_name, ANY, self._vehicle_id), arrived)

    def _pose(self, sample: zenoh.Sample) -> BodyPose | None:
        source = pose_source_of(str(sample.key_expr))
        if source is None:
            self._reject(Code.POSE_MALFORMED)
            return None
        return self._decode(sample, decode_pose, f"{ParticipantRole.MOCAP}-{source}")

    def publish_peer(self, packet: PeerPacket) -> None:
        """Publish the own peer packet."""
        if self._terms:
            packet = self._terms.attach(packet)
        if self._datagrams:
            self._datagrams.publish_peer(packet)
        else:
            self._peers.publish(packet)

    def set_low_rate_peers(self, distant_ids: Collection[int]) -> None:
        """Receive these peers at 5 Hz and all others at 50 Hz. Everyone hears multicast datagrams: they stay at 50 Hz."""
        if not self._datagrams:
            self._peers.set_low_rate_peers(distant_ids)

    def publish_status(self, report: StatusReport) -> None:
        """Publish the own status."""
        self._status_publisher.put(encode(report))

    def reply(self, replies: Iterable[CommandReply]) -> None:
        """Publish and log the replies to the commands of the last `receive`."""
        for reply in replies:
            if asked := self._unanswered.pop((reply.operator, reply.number), None):
                self._log.log(*asked, reply, time.monotonic())
            self._reply_publisher.put(encode(reply))

    def admission_lists(self) -> Sequence[bytes]:
        """Admission lists since the last call, not verified. Never blocks."""
        if self._lists is None:
            return ()
        return tuple(sample.payload.to_bytes() for sample in drain(self._lists, LISTS_KEPT))

    def admit(self, admitted: Admitted) -> None:
        """From now on use nothing from those that this newer list does not admit.

        Zenoh's access control keeps the names with which the session began, so a new identity is connected after a restart.
        """
        assert self._identity is not None
        names = self._identity.admitted.participants
        refused = [parse_common_name(one.name) for one in names if admitted.participant(one.name) is None]
        self._refused = frozenset(str(name) for name in refused) | {name.participant for name in refused}
        if self._terms:
            self._terms.admit(admitted)
        for name in refused:
            if name.role is ParticipantRole.VEHICLE:
                self._peers.refuse(int(name.id))
                if self._datagrams and self._datagrams.seal:
                    self._datagrams.seal.forget(int(name.id))
        self.network = NetworkState("identity", admitted.number)

    def close(self) -> None:
        """Close the session. Zenoh may wait for a client that reads nothing; the process does not."""
        closing = threading.Thread(target=self.session.close, name="closing", daemon=True)
        closing.start()
        closing.join(CLOSE_WITHIN_S)

    def _target(self, sample: zenoh.Sample, now_s: float) -> ReceivedTarget | None:
        name = target_of(str(sample.key_expr))
        if name is None:
            self._reject(Code.TARGET_MALFORMED)
            return None
        target = self._decode(sample, decode_target, f"{ParticipantRole.TARGET}-{name}")
        return ReceivedTarget(now_s, name, target) if target else None

    def _traffic_sample(self, sample: zenoh.Sample, now_s: float) -> ReceivedTraffic | None:
        source, name = traffic_of(str(sample.key_expr)) or ("", "")
        if not TRAFFIC_NAME.fullmatch(name):  # it appears in events and on terminals
            self._reject(Code.TRAFFIC_MALFORMED)
            return None
        traffic = self._decode(sample, decode_traffic, f"{ParticipantRole.TRAFFIC}-{source}")
        return ReceivedTraffic(now_s, name, traffic) if traffic else None

    def _decode(self, sample: zenoh.Sample, decode: Callable[[bytes], Message], sender: str = "") -> Message | None:
        """The message; None, which is counted, where it is malformed or its sender is no longer admitted."""
        if sender in self._refused:
            self._reject(Code.NOT_ADMITTED)
            return None
        try:
            return decode(sample.payload.to_bytes())
        except WireError as error:
            self._reject(error.key)
            return None

    def _refuse(self, code: Code) -> Callable[[], None]:
        return lambda: self._reject(code)

    def _receive_aborts(self) -> list[Command]:
        """The first ABORTS_KEPT aborts on the abort key; the channel is emptied in any case."""
        aborts: list[Command] = []
        for sample in drain(self._aborts, ABORT_SAMPLES_KEPT):
            if len(aborts) < ABORTS_KEPT:
                aborts += each((sample,), self._abort, self._refuse(Code.COMMAND_MALFORMED))
        for command in aborts:
            self._note(COMMAND, command)
        return aborts

    def _abort(self, sample: zenoh.Sample) -> Command | None:
        if len(sample.payload) > LONGEST_ABORT or ABORT_TEXT not in sample.payload.to_bytes():
            self._reject(Code.COMMAND_MALFORMED)
        elif (command := self._decode_command(sample, abort_key)) is not None:
            if command.name is CommandName.ABORT:
                return command
            self._reject(Code.COMMAND_MALFORMED)
        return None

    def _decode_command(self, sample: zenoh.Sample, key: Callable[[str, int, str], str]) -> Command | None:
        """The command; None for one that is malformed, or under the key of another operator than it names."""
        command = self._decode(sample, decode_command)
        if command is None:
            return None
        if str(sample.key_expr) != key(self._fleet_name, self._vehicle_id, command.operator):
            self._reject(Code.COMMAND_KEY_MISMATCH)
        elif command.operator in self._refused:
            self._reject(Code.NOT_ADMITTED)
        else:
            return command
        return None

    def _note(self, kind: str, command: Command) -> None:
        """Keep a command, or a check, until its reply is logged."""
        self._unanswered[command.operator, command.number] = kind, command
        if len(self._unanswered) > UNANSWERED_KEPT:
            del self._unanswered[next(iter(self._unanswered))]

    def _command(self, sample: zenoh.Sample, late: bool) -> Command | None:
        """The command in a message; None where it is malformed, and where it comes late, which is answered here."""
        if (command := self._decode_command(sample, command_key)) is None:
            return None
        self._note(COMMAND, command)
        if late and command.name not in ACCEPTED_LATE:
            reason = "arrived while this agent was paused; give it again"
            self.reply(
                [CommandReply(self._vehicle_id, command.number, False, Code.COMMAND_LATE, reason, command.operator)]
            )
            return None
        return command


def _received(now_s: float, packets: list[PeerPacket]) -> tuple[ReceivedPeerPacket, ...]:
    return tuple([ReceivedPeerPacket(now_s, packet) for packet in packets])


def _term_proofs(vehicle_id: int, fleet: FleetConfig, identity: Identity, reject: Callable[[str], None]) -> TermProofs:
    """Only a link with an identity loads the library for it. Raises IdentityError."""
    from companion.link.fleet.term_proofs import TermProofs

    return TermProofs(vehicle_id, fleet, identity.key(), identity.admitted, reject)
