"""Decodable hostile messages for whole agents, made from the true ones by seeded changes."""

from __future__ import annotations

from collections import Counter, deque
from random import Random
from typing import Any

from msgspec.structs import replace

from companion.core.consensus.law import formation_state
from companion.types.autopilot import PositionError, Telemetry
from companion.types.commands import CONTENT, Command, CommandName, Lead, ReferenceChange
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationChange, HeldReference, LeaderBeacon
from companion.types.peers import LeaderReport, PeerPacket, ReceivedTarget, ReceivedTraffic, TargetSample, TrafficSample
from companion.wire.messages import (
    WireError,
    decode_command,
    decode_peer,
    decode_target,
    decode_traffic,
    encode,
    encode_peer,
)
from tests.fuzz.fleet import OPERATOR, Hostile, HostileFleet
from tests.fuzz.mavlink import HostileTelemetry
from tests.fuzz.mutation import mutated, other

COUNTS = (0, 0, 1, 1, 2, 4)  # of hostile packets in a tick
COMMAND_SHARE, TARGET_SHARE, TRAFFIC_SHARE, REPLAY_SHARE = 0.1, 0.1, 0.1, 0.1
KEPT_OFF_SHARE = 0.3  # of hostile packets
FLOOD_SHARE = 0.002  # as many as an agent takes in a tick
PACKETS_A_VEHICLE, COMMANDS_A_TICK, TRAFFIC_A_TICK = 8, 32, 32
TELEMETRY_SHARE = 0.05  # one packet in 20 ticks: each wrong mode is a pilot who takes over
DESCRIBED: tuple[dict[str, Any], ...] = (
    {"kind": "point", "point_enu_m": [0.0, 0.0, 4.0]},
    {"kind": "circle", "centre_enu_m": [0.0, 0.0, 4.0], "radius_m": 5.0, "period_s": 40.0, "ramp_s": 5.0},
    {"kind": "figure_8", "centre_enu_m": [0.0, 0.0, 4.0], "width_m": 8.0, "height_m": 4.0, "period_s": 60.0},
    {
        "kind": "waypoints",
        "points_enu_m": [[0.0, 0.0, 4.0], [5.0, 0.0, 4.0]],
        "wait_s": 1.0,
        "max_speed_m_s": 2.0,
        "max_acceleration_m_s2": 1.0,
    },
    {"kind": "target", "start_enu_m": [0.0, 0.0, 4.0], "name": "main", "max_speed_m_s": 2.0, "max_age_s": 1.0},
)


class HostileStream:
    """The hostile messages of one tick for each vehicle. `refused` counts those that the wire already refuses, by kind."""

    def __init__(self, rng: Random, fleet: HostileFleet, gives_commands: bool, sends_telemetry: bool = False) -> None:
        self._rng = rng
        self._fleet = fleet
        self._gives_commands = gives_commands
        self._recorded: deque[PeerPacket] = deque(maxlen=600)
        self.refused: Counter[str] = Counter()
        self.passed: Counter[str] = Counter()
        self._telemetry = {i: HostileTelemetry(rng, i) for i in fleet.agents} if sends_telemetry else {}
        for telemetry in self._telemetry.values():
            telemetry.passed, telemetry.refused = self.passed, self.refused

    def next(self) -> dict[int, Hostile]:
        self._recorded.extend(self._fleet.packets.values())
        return {i: self._for_vehicle(i) for i in self._fleet.agents}

    def _for_vehicle(self, vehicle_id: int) -> Hostile:
        rng = self._rng
        count = PACKETS_A_VEHICLE * len(self._fleet.agents) if rng.random() < FLOOD_SHARE else rng.choice(COUNTS)
        packets = [self._packet() for _ in range(count)] if self._recorded else []
        commands = self._commands(vehicle_id) if self._gives_commands else []
        targets = [self._target()] if rng.random() < TARGET_SHARE else []
        samples = TRAFFIC_A_TICK if rng.random() < FLOOD_SHARE else rng.random() < TRAFFIC_SHARE
        traffic = [self._traffic(vehicle_id) for _ in range(samples)]
        telemetry: list[Telemetry] = []
        if self._telemetry and rng.random() < TELEMETRY_SHARE:
            plant = self._fleet.plants[vehicle_id]
            telemetry = self._telemetry[vehicle_id].next(plant, self._fleet.now_s)
        return Hostile(
            [p for p in packets if p],
            [c for c in commands if c],
            [t for t in targets if t],
            [t for t in traffic if t],
            telemetry,
        )

    def _packet(self) -> PeerPacket | None:
        rng = self._rng
        if rng.random() < REPLAY_SHARE:
            return rng.choice(self._recorded)
        base = self._recorded[-rng.randint(1, min(3, len(self._recorded)))]
        sequence = base.sender.sequence + rng.choice((0, 1, 1, 2, 3))
        base = replace(base, sender=replace(base.sender, sequence=sequence))
        if rng.random() < 0.4:
            base = self._as_leader(base)
        if rng.random() < KEPT_OFF_SHARE:
            base = self._kept_off(base)
        hostile = mutated(rng, base, rng.choice((0, 1, 1, 2, 3)))
        received: PeerPacket | None = self._through("packet", encode_peer, decode_peer, hostile)
        return received

    def _as_leader(self, packet: PeerPacket) -> PeerPacket:
        """The packet of a leader in formation that passes on a change."""
        rng, status = self._rng, self._fleet.statuses.get(1)
        epoch, reference_s = (status.leadership.epoch, status.formation.reference_s) if status else (0, 0.0)
        beacon = LeaderBeacon(
            packet.sender.vehicle_id,
            epoch + rng.choice((0, 0, 1, 2)),
            int(self._fleet.now_s * 1000),
            reference_s + 0.02,
        )
        held = packet.reference or HeldReference()
        phase = rng.choice((FlightPhase.FORMATION, packet.phase))
        change = self._change() if rng.random() < 0.5 else None
        leader = replace(packet, role=Role.LEADER, leader=LeaderReport(1, beacon), phase=phase, change=change)
        return replace(leader, reference=other(rng, held) if rng.random() < 0.2 else held)

    def _kept_off(self, packet: PeerPacket) -> PeerPacket:
        """The packet of a vehicle that makes way for another one, with the position error that its estimator reports."""
        rng, own = self._rng, formation_state(packet.motion.position_enu_m, packet.motion.velocity_enu_m_s, packet.slot)
        rft, error = (own.position_enu_m, own.velocity_enu_m_s, own.acceleration_enu_m_s2), PositionError(0.3, 0.4)
        return replace(
            packet, rft=rng.choice((rft, other(rng, rft))), position_error=rng.choice((error, other(rng, error)))
        )

    def _change(self) -> FormationChange:
        rng, status = self._rng, self._fleet.statuses.get(1)
        number, reference_s = (status.formation.slot.waiting, status.formation.reference_s) if status else (0, 0.0)
        scale = rng.choice((0.5, 1.0, 1.2, 2.0))
        slots = tuple((m.id, (m.slot_enu_m[0] * scale, 0.0, 0.0)) for m in self._fleet.config.vehicles)
        absent = rng.choice(((), (), (3,), tuple(self._fleet.agents)))
        change = FormationChange(number + rng.choice((0, 1, 2)), slots, reference_s + 1.5, 6.0, absent)
        return mutated(rng, change, rng.choice((0, 1, 2)))

    def _commands(self, vehicle_id: int) -> list[Command | None]:
        """At most one, or as many with content as an agent takes in a tick: these cost the most."""
        rng = self._rng
        if rng.random() < FLOOD_SHARE:
            name = rng.choice(sorted(CONTENT))
            return [self._command(vehicle_id, name, ahead) for ahead in range(COMMANDS_A_TICK)]
        if rng.random() < COMMAND_SHARE:
            return [self._command(vehicle_id, rng.choice(list(CommandName)))]
        return []

    def _command(self, vehicle_id: int, name: CommandName, ahead: int = 0) -> Command | None:
        rng, status = self._rng, self._fleet.statuses.get(vehicle_id)
        if status is None:
            return None
        content: Any = None
        if name in CONTENT:
            held = status.formation.reference.waiting if status.formation.reference else 0
            described = rng.choice(DESCRIBED)
            content = {
                CommandName.LEAD: Lead((rng.choice(tuple(self._fleet.agents)),), status.leadership.epoch + 1),
                CommandName.FORMATION: self._change(),
                CommandName.REFERENCE: ReferenceChange(held + 1, described, status.formation.reference_s + 1.5),
            }[name]
            content = mutated(rng, content, rng.choice((0, 1, 2)))
        operator = rng.choice((OPERATOR, "mallory@hill"))
        command = Command(name, status.command.command_number + 1 + ahead, operator, status.agent.session, content)
        if rng.random() < 0.3:
            command = replace(command, number=other(rng, command.number))
        received: Command | None = self._through("command", encode, decode_command, command)
        return received

    def _target(self) -> ReceivedTarget | None:
        rng, now_s = self._rng, self._fleet.now_s
        sample = TargetSample(rng.choice((1, 1, 2)), self._fleet.ticks, now_s, (1.0, 0.0, 0.0), (1.0, 1.0, 3.0))
        passed = self._through("target", encode, decode_target, mutated(rng, sample, rng.choice((0, 1, 2))))
        return ReceivedTarget(now_s, "main", passed) if passed else None

    def _traffic(self, vehicle_id: int) -> ReceivedTraffic | None:
        """A vehicle outside the fleet, near or far, under one of many names."""
        rng, now_s = self._rng, self._fleet.now_s
        x, y, z = self._fleet.plants[vehicle_id].position_enu_m
        near = (x + rng.gauss(0.0, 5.0), y + rng.gauss(0.0, 5.0), z + rng.gauss(0.0, 2.0))
        sample = TrafficSample(near, (rng.gauss(0.0, 3.0), rng.gauss(0.0, 3.0), 0.0), 0.1, 1.0)
        hostile = mutated(rng, sample, rng.choice((0, 1, 2)))
        passed = self._through("traffic", encode, decode_traffic, hostile)
        name = rng.choice(("a", "a", "b", f"{rng.randrange(10**6):06x}"))
        return ReceivedTraffic(now_s, name, passed) if passed else None

    def _through(self, kind: str, encoder: Any, decoder: Any, message: Any) -> Any:
        """The message as its receiver decodes it; None where the wire refuses it, or cannot carry it."""
        try:
            received = decoder(encoder(message))
        except (WireError, OverflowError):
            self.refused[kind] += 1
            return None
        self.passed[kind] += 1
        return received
