"""A fleet of real agents over simple plants, with a true operator. Every message passes the wire as between processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from math import hypot, isfinite, radians
from random import Random
from time import thread_time
from typing import NamedTuple

from companion.assembly import build_agent
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember, PeerLimits, RangeNeighbours
from companion.config.law import LawSection
from companion.config.reference import CircleReference, PointReference, Reference, TargetReference
from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.core.agent import Agent
from companion.core.consensus.neighbours import LOW_RATE_TICKS
from companion.types.autopilot import AttitudeTarget, Telemetry
from companion.types.commands import Command, CommandName, CommandReply, Content, next_number
from companion.types.flight import Role
from companion.types.peers import PeerPacket, ReceivedPeerPacket, ReceivedTarget, ReceivedTraffic
from companion.types.status import Status
from companion.types.tick import Inbox, Outbox
from companion.wire.messages import (
    StatusReport,
    WireError,
    decode_peer,
    decode_reply,
    decode_report,
    encode,
    encode_peer,
)
from sitl.flight.virtual_vehicle import NOT_TIMED
from tests.fuzz.plant import HOVER_THRUST_NORM, TICK_S, Plant

ANSWERED_WITHIN = 100  # ticks: formations and references are judged in steps
OPERATOR = "anna@ground"
MAX_TILT_DEG = 25.0
CHAIN = 6  # vehicles
SPACING_M, WIDE_M = 3.0, 16.0
BEGIN_S = 100.0


class InvariantError(AssertionError):
    """An output or a state that no input may cause."""


class Hostile(NamedTuple):
    """What one agent receives in a tick besides the true messages."""

    packets: Sequence[PeerPacket] = ()
    commands: Sequence[Command] = ()
    targets: Sequence[ReceivedTarget] = ()
    traffic: Sequence[ReceivedTraffic] = ()
    telemetry: Sequence[Telemetry] = ()


NOTHING = Hostile()


def fleet_config(rng: Random, is_chain: bool = False, is_wide: bool = False) -> FleetConfig:
    """A leader, a successor and followers; law, heading, neighbours and gap filling at random.

    Three vehicles that all receive each other, or a chain of six: each one's neighbours are the next ones. `is_wide`: so far
    apart that they receive all but these at 5 Hz.
    """
    spacing_m = WIDE_M if is_wide else SPACING_M
    ids = range(1, CHAIN + 1) if is_chain else range(1, 4)
    chain = EdgeNeighbours(edges=tuple((i, i + 1) for i in ids[:-1]))
    triangle = EdgeNeighbours(edges=((1, 2), (2, 3), (1, 3)))
    neighbours = rng.choice((triangle, RangeNeighbours(range_m=30.0, hysteresis_m=3.0)))
    return FleetConfig(
        name="hostile",
        origin="indoor",
        vehicles=tuple(
            FormationMember(
                id=i,
                role=Role.LEADER if i == 1 else Role.FOLLOWER,
                slot_enu_m=(-spacing_m * (i - 1), 0.0, 0.0),
                may_lead=i == 2,
            )
            for i in ids
        ),
        neighbours=chain if is_chain else neighbours,
        law=LawSection(name=rng.choice(("cooperative", "weighted"))),
        peers=PeerLimits(full_rate_up_to=1) if is_wide else PeerLimits(),
        takeoff_height_m=3.0,
        formation_heading=rng.choice(("fixed", "course")),
        when_one_leaves=rng.choice(("keep_gap", "close_up")),
        successors=rng.choice(((), (2,))),
        land_after_s=rng.choice((None, 5.0)),
    )


def reference(rng: Random) -> Reference:
    return rng.choice(
        (
            PointReference(point_enu_m=(0.0, 0.0, 3.0)),
            CircleReference(centre_enu_m=(-8.0, 0.0, 3.0), radius_m=8.0, period_s=60.0),
            TargetReference(start_enu_m=(0.0, 0.0, 3.0)),
        )
    )


class HostileFleet:
    """Three vehicles, or a chain of six. `tick` passes the true packets of the last tick on, and checks every output."""

    def __init__(self, rng: Random, is_chain: bool = False, is_wide: bool = False) -> None:
        self.config, first = fleet_config(rng, is_chain, is_wide), reference(rng)
        self.now_s, self.ticks = BEGIN_S, 0
        self.agents: dict[int, Agent] = {}
        self.plants: dict[int, Plant] = {}
        for member in self.config.vehicles:
            vehicle = VehicleConfig(
                id=member.id,
                fleet="fleet.yaml",
                mavlink="udpin:127.0.0.1:14540",
                hover_thrust_norm=HOVER_THRUST_NORM,
                reference=first if member.can_lead else None,
            )
            self.agents[member.id] = build_agent(AgentConfig(vehicle, self.config, member), session=member.id * 1000)
            self.plants[member.id] = Plant(member.slot_enu_m)
        self.packets: dict[int, PeerPacket] = {}  # the true ones of the last tick
        self.distant: dict[int, tuple[int, ...]] = {}  # whom each vehicle receives at 5 Hz
        self.statuses: dict[int, Status] = {}
        self.replies: dict[int, CommandReply] = {}  # to the last commands of the operator
        self.longest_tick_s = 0.0
        self.longest_tick = ""  # what it received
        self.tick_seconds = 0.0
        self._rng = rng
        self._given: dict[int, Command] = {}
        self._numbers: dict[int, int] = {}

    def tick(self, hostile: Mapping[int, Hostile] | None = None) -> None:
        """One tick of every vehicle. Raises InvariantError, and whatever an agent raises."""
        self.now_s += TICK_S
        outboxes = {i: self._step(i, hostile[i] if hostile else NOTHING) for i in self.agents}
        self.packets = {i: outbox.peer_packet for i, outbox in outboxes.items() if outbox.peer_packet}
        for i, outbox in outboxes.items():
            self._check(i, outbox)
            self.plants[i].execute(self.now_s, outbox.requests)
            self.plants[i].move(outbox.attitude_target)

    def give(self, vehicle_id: int, name: CommandName, content: Content | None = None) -> None:
        """A command of the true operator, for the next tick."""
        status = self.statuses[vehicle_id]
        number = next_number(self._numbers.get(vehicle_id, 0), status.command.command_number)
        self._numbers[vehicle_id] = number
        self._given[vehicle_id] = Command(name, number, OPERATOR, status.agent.session, content)

    def command(self, name: CommandName, content: Content | None = None) -> dict[int, CommandReply]:
        """The replies to a command of the true operator to every vehicle. Raises InvariantError where one does not answer."""
        self.replies = {}
        for i in self.agents:
            self.give(i, name, content)
        for _ in range(ANSWERED_WITHIN):
            self.tick()
            if self.replies.keys() == self.agents.keys():
                return self.replies
        raise InvariantError(f"{name} is not answered by {sorted(self.agents.keys() - self.replies.keys())}")

    def _step(self, vehicle_id: int, hostile: Hostile) -> Outbox:
        packets = [packet for packet in self.packets.values() if self._reaches(packet, vehicle_id)]
        packets[self._rng.randint(0, len(packets)) : 0] = hostile.packets
        commands = list(hostile.commands)
        if given := self._given.pop(vehicle_id, None):
            commands.append(given)
        telemetry = list(self.plants[vehicle_id].telemetry(self.now_s))
        if hostile.telemetry:
            telemetry[self._rng.randint(0, len(telemetry)) : 0] = hostile.telemetry
        inbox = Inbox(
            tuple(telemetry),
            tuple([ReceivedPeerPacket(self.now_s, packet) for packet in packets]),
            tuple(commands),
            targets=tuple(hostile.targets),
            traffic=tuple(hostile.traffic),
        )
        begin_s = thread_time()
        outbox = self.agents[vehicle_id].step(self.now_s, inbox)
        seconds = thread_time() - begin_s
        self.distant[vehicle_id] = outbox.distant_ids
        self.ticks, self.tick_seconds = self.ticks + 1, self.tick_seconds + seconds
        if seconds > self.longest_tick_s:
            self.longest_tick_s, self.longest_tick = seconds, self._described(vehicle_id, inbox)
        for reply in outbox.replies:
            if reply.operator == OPERATOR and reply.number == self._numbers.get(vehicle_id):
                self.replies[vehicle_id] = reply
        return outbox

    def _reaches(self, packet: PeerPacket, vehicle_id: int) -> bool:
        """Of a vehicle that is received at 5 Hz every tenth packet, as `PeerStates` publishes it."""
        sender_id = packet.sender.vehicle_id
        if sender_id in self.distant.get(vehicle_id, ()):
            return (packet.sender.sequence + sender_id) % LOW_RATE_TICKS == 0
        return sender_id != vehicle_id

    def _described(self, vehicle_id: int, inbox: Inbox) -> str:
        """What the agent received in this tick."""
        phase, at = self.agents[vehicle_id].phase, round((self.now_s - BEGIN_S) / TICK_S)
        counted = Counter(command.name.value for command in inbox.commands)
        commands = ", ".join(f"{number} {name}" for name, number in counted.items()) or "no command"
        others = f"{len(inbox.peers)} packets, {len(inbox.traffic)} of traffic"
        return f"vehicle {vehicle_id} in {phase}, tick {at}: {others}, {commands}"

    def _check(self, vehicle_id: int, outbox: Outbox) -> None:
        """Outputs are finite, within limits, and acceptable to every receiver."""
        target = outbox.attitude_target
        if target and not _is_within_limits(target):
            raise InvariantError(f"setpoint outside its limits: {target}")
        if outbox.status is None:
            return
        self.statuses[vehicle_id] = outbox.status
        try:
            decode_report(encode(StatusReport(outbox.status, NOT_TIMED)))
            for reply in outbox.replies:
                decode_reply(encode(reply))
            if outbox.peer_packet and decode_peer(encode_peer(outbox.peer_packet)) != outbox.peer_packet:
                raise InvariantError("a peer packet changes on the wire")
        except WireError as error:
            raise InvariantError(f"emits a message that no receiver decodes: {error}") from error


def _is_within_limits(target: AttitudeTarget) -> bool:
    tilt_rad = hypot(target.roll_rad, target.pitch_rad)
    return tilt_rad <= radians(MAX_TILT_DEG) + 1e-9 and isfinite(target.yaw_rad) and 0.0 <= target.thrust_norm <= 1.0
