"""One stage of all vehicles, tick by tick: the consensus alone, or the separation filter before point masses.

The point masses answer an acceleration after a dead time and two low passes, as PX4's measured attitude step response: 50 %
after 0.2 s. Peer states may be late, lost and noisy. Packets, peer table and stages are the agent's own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import combinations, product
from math import dist, exp, hypot, radians, sqrt, tan
from random import Random
from typing import Literal

from msgspec.structs import replace

from common import AT_REST
from companion.assembly import safety_filter_of
from companion.config.fleet import EdgeNeighbours, Envelope, FleetConfig, FormationMember
from companion.config.law import LawSection
from companion.config.values import Obstacle
from companion.core.consensus.law import feedback
from companion.core.consensus.neighbours import EdgeRule
from companion.core.consensus.peers import FleetLimits, PeerTable
from companion.core.consensus.stage import Consensus, ConsensusStage
from companion.core.election.beacon import BeaconMonitor
from companion.core.election.leadership import Leadership, Succession
from companion.core.filter.solver import AccelerationLimits
from companion.types.autopilot import PositionError, VehicleState
from companion.types.commands import Lead
from companion.types.flight import Flight, FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot, Gains
from companion.types.peers import (
    LeaderReport,
    Motion,
    PeerPacket,
    ReceivedPeerPacket,
    ReceivedTraffic,
    Sender,
    TrafficSample,
)
from companion.types.status import SeparationReport
from companion.types.values import ZERO3, Vector3

TICK_S = 0.02
DEAD_TICKS = 3
LOW_PASS_S = 0.07
DRAG_1_S = 0.25
GAINS = Gains(1.39, 1.2)
LIMITS = FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0))
STILL = AccelerationLimits.of_envelope(tan(radians(25.0)), 0.3, 1.6)  # the default envelope, without wind


@dataclass(frozen=True, slots=True)
class Noise:
    """Slow drift of position and velocity, white noise of the velocity, and the error that the estimator reports."""

    position_sd_m: float = 0.0
    velocity_sd_m_s: float = 0.0
    white_sd_m_s: float = 0.0
    reported: PositionError | None = None


IDEAL = Noise()
DEFAULT = Noise(0.04, 0.03, 0.02, PositionError(0.06, 0.05))
PX4_SIH = Noise(0.11, 0.13, 0.03, PositionError(0.15, 0.16))


@dataclass(frozen=True, slots=True)
class Link:
    delay_s: float = 0.001
    jitter_s: float = 0.0
    loss: float = 0.0


class Drift:
    """First-order Gauss-Markov error of three components."""

    def __init__(self, sd: float, time_s: float, random: Random) -> None:
        self._sd, self._keeps, self._random = sd, exp(-TICK_S / time_s), random
        self.value = tuple(random.gauss(0.0, sd) for _ in range(3))

    def step(self) -> None:
        fresh = self._sd * sqrt(1.0 - self._keeps**2)
        self.value = tuple(self._keeps * x + self._random.gauss(0.0, fresh) for x in self.value)


Wish = Callable[[float, VehicleState], Vector3]


def to_goal(goal_enu_m: Vector3, gains: Gains = GAINS) -> Wish:
    """Eq. 14 of a leader whose reference stands still."""

    def wish(_now_s: float, vehicle: VehicleState) -> Vector3:
        (x, y, z), (gx, gy, gz) = vehicle.position_enu_m, goal_enu_m
        return feedback(gains, (x - gx, y - gy, z - gz), vehicle.velocity_enu_m_s)

    return wish


@dataclass
class Body:
    """One vehicle. `filters` is False for one that ignores all others; its phase is what it reports."""

    vehicle_id: int
    position_enu_m: Vector3
    wish: Wish
    velocity_enu_m_s: Vector3 = ZERO3
    phase: FlightPhase = FlightPhase.FORMATION
    filters: bool = True
    armed: bool = True
    slot: FlownSlot = field(default_factory=lambda: FlownSlot(ZERO3))


@dataclass
class Intruder:
    """A vehicle outside the fleet that flies straight on and makes no way, published every `period_s` while `published`.

    Samples are `age_s` old when they arrive. `error_m` is reported; the published position is the true one.
    """

    name: str
    position_enu_m: Vector3
    velocity_enu_m_s: Vector3 = ZERO3
    error_m: float = 0.0
    age_s: float = 0.0
    period_s: float = 1.0
    published: bool = True
    height: Literal["fleet", "unknown"] = "fleet"

    def move(self) -> None:
        self.position_enu_m = self._at(TICK_S)

    def sample(self, now_s: float) -> ReceivedTraffic:
        sample = TrafficSample(self._at(-self.age_s), self.velocity_enu_m_s, self.age_s, self.error_m, self.height)
        return ReceivedTraffic(now_s, self.name, sample)

    def _at(self, ahead_s: float) -> Vector3:
        (x, y, z), (vx, vy, vz) = self.position_enu_m, self.velocity_enu_m_s
        return (x + vx * ahead_s, y + vy * ahead_s, z + vz * ahead_s)


class SeparationFlight:
    """All vehicles, tick by tick. `apart_m` is the least true distance so far of each pair that flies.

    `least_counted_m` is that of any two, also of traffic, with heights that count half.
    """

    def __init__(
        self,
        bodies: Iterable[Body],
        separation_m: float,
        noise: Noise = IDEAL,
        link: Link = Link(),
        seed: int = 1,
        envelope: Envelope | None = None,
        obstacles: tuple[Obstacle, ...] = (),
        intruders: Iterable[Intruder] = (),
    ) -> None:
        self.bodies = {body.vehicle_id: body for body in bodies}
        self.intruders = tuple(intruders)
        self.now_s = 100.0
        self.apart_m: dict[tuple[int, int], float] = dict.fromkeys(combinations(sorted(self.bodies), 2), 1e9)
        self.least_counted_m = 1e9
        self.reports: dict[int, SeparationReport] = {}
        self.interventions = 0
        self.silent: set[int] = set()
        self.reported_error: dict[int, PositionError] = {}  # in the packets of a vehicle, instead of its own
        self._noise, self._link, self._random = noise, link, Random(f"{seed} link")
        random = Random(f"{seed} noise")
        self._position = {i: Drift(noise.position_sd_m, 20.0, random) for i in self.bodies}
        self._velocity = {i: Drift(noise.velocity_sd_m_s, 2.0, random) for i in self.bodies}
        self._white = random
        may_lead = dict.fromkeys(self.bodies, True)
        self._tables = {i: PeerTable(i, may_lead, 1, 0.3, LIMITS, ()) for i in self.bodies}
        fleet = _fleet(self.bodies, separation_m, envelope or Envelope(), obstacles)
        self._filters = {i: safety_filter_of(fleet, i) for i in self.bodies}
        self._commanded = dict.fromkeys(self.bodies, ZERO3)
        self._dead = {i: deque([ZERO3] * DEAD_TICKS) for i in self.bodies}
        self._low: dict[int, tuple[Vector3, Vector3]] = dict.fromkeys(self.bodies, (ZERO3, ZERO3))
        self._on_the_way: list[tuple[float, int, PeerPacket]] = []
        self._sequence = 0

    @property
    def nearest_m(self) -> float:
        return min(self.apart_m.values())

    def fly(self, seconds: float) -> None:
        for _ in range(round(seconds / TICK_S)):
            self.tick()

    def tick(self) -> None:
        self.now_s += TICK_S
        self._sequence += 1
        states = {i: self._estimate(body) for i, body in self.bodies.items()}
        traffic = [one.sample(self.now_s) for one in self.intruders if self._publishes(one)]
        for i, state in states.items():
            self._filters[i].receive(self.now_s, state, traffic)
            self._decide(i, state)
        for i, state in states.items():
            if i not in self.silent:
                self._send(i, state)
        for i, body in self.bodies.items():
            self._move(i, body)
        for intruder in self.intruders:
            intruder.move()
        self._measure()

    def _publishes(self, intruder: Intruder) -> bool:
        return intruder.published and (self._sequence - 1) % round(intruder.period_s / TICK_S) == 0

    def _measure(self) -> None:
        for i, j in self.apart_m:
            one, other = self.bodies[i].position_enu_m, self.bodies[j].position_enu_m
            self.apart_m[i, j] = min(self.apart_m[i, j], dist(one, other))
            self.least_counted_m = min(self.least_counted_m, counted_m(one, other))
        for body, intruder in product(self.bodies.values(), self.intruders):
            self.least_counted_m = min(self.least_counted_m, counted_m(body.position_enu_m, intruder.position_enu_m))

    def _estimate(self, body: Body) -> VehicleState:
        i, white = body.vehicle_id, self._noise.white_sd_m_s
        self._position[i].step()
        self._velocity[i].step()
        position = [x + e for x, e in zip(body.position_enu_m, self._position[i].value, strict=True)]
        velocity = [
            v + e + (self._white.gauss(0.0, white) if white else 0.0)
            for v, e in zip(body.velocity_enu_m_s, self._velocity[i].value, strict=True)
        ]
        return VehicleState(
            position_enu_m=(position[0], position[1], position[2]),
            velocity_enu_m_s=(velocity[0], velocity[1], velocity[2]),
            position_time_s=self.now_s,
            armed=body.armed,
            ground_position_enu_m=(body.position_enu_m[0], body.position_enu_m[1], 0.0),
            position_error=self._noise.reported,
        )

    def _decide(self, i: int, state: VehicleState) -> None:
        body, table = self.bodies[i], self._tables[i]
        arrived = [(at_s, to, packet) for at_s, to, packet in self._on_the_way if to == i and at_s <= self.now_s]
        self._on_the_way = [one for one in self._on_the_way if one not in arrived]
        arrived.sort(key=lambda one: one[0])
        table.fold([ReceivedPeerPacket(self.now_s, packet) for _, _, packet in arrived], 0)
        wanted = body.wish(self.now_s, state)
        if body.filters:
            result = self._filters[i].step(
                self.now_s,
                state,
                body.slot if body.phase is FlightPhase.FORMATION else None,
                table.known,
                table.in_time(self.now_s)[0],
                wanted,
                self._commanded[i],
                ZERO3,
            )
            self.reports[i] = result.separation
            self.interventions += result.acceleration_enu_m_s2 is not wanted
            wanted = result.acceleration_enu_m_s2
        self._commanded[i] = STILL.limit(wanted)

    def _send(self, i: int, state: VehicleState) -> None:
        body = self.bodies[i]
        acceleration_enu_m_s2 = ZERO3
        if body.phase is FlightPhase.FORMATION:
            acceleration_enu_m_s2 = self._commanded[i]
        elif body.phase is FlightPhase.OBSERVE:  # as its attitude shows
            (x, y, _), (vx, vy, _) = self._low[i][1], body.velocity_enu_m_s
            acceleration_enu_m_s2 = (x - DRAG_1_S * vx, y - DRAG_1_S * vy, 0.0)
        packet = PeerPacket(
            sender=Sender(vehicle_id=i, session=1, sequence=self._sequence, formation_hash=1),
            phase=body.phase,
            role=Role.FOLLOWER,
            motion=Motion(
                position_enu_m=state.position_enu_m,
                velocity_enu_m_s=state.velocity_enu_m_s,
                acceleration_enu_m_s2=acceleration_enu_m_s2,
                state_age_s=0.0,
                sent_s=self.now_s,
            ),
            leader=LeaderReport(prc=2, beacon=None),
            slot=body.slot,
            position_error=self.reported_error.get(i, state.position_error),
            armed=body.armed,
        )
        for j in self.bodies:
            if j != i and self._random.random() >= self._link.loss:
                late_s = self._link.delay_s + self._link.jitter_s * self._random.random()
                self._on_the_way.append((self.now_s + late_s, j, packet))

    def _move(self, i: int, body: Body) -> None:
        self._dead[i].append(self._commanded[i])
        asked = self._dead[i].popleft()
        first, second = self._low[i]
        share = 1.0 - exp(-TICK_S / LOW_PASS_S)
        first = _towards(first, asked, share)
        second = _towards(second, first, share)
        self._low[i] = first, second
        (x, y, z), (vx, vy, vz) = body.position_enu_m, body.velocity_enu_m_s
        vx, vy, vz = (v + (a - DRAG_1_S * v) * TICK_S for v, a in zip((vx, vy, vz), second, strict=True))
        body.velocity_enu_m_s = (vx, vy, vz)
        body.position_enu_m = (x + vx * TICK_S, y + vy * TICK_S, z + vz * TICK_S)


def _towards(a: Vector3, b: Vector3, share: float) -> Vector3:
    return (a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2]))


def counted_m(one_enu_m: Vector3, other_enu_m: Vector3) -> float:
    """Distance of two vehicles in flight as `docs/separation.md` states it: a metre of height counts half."""
    (x, y, z), (px, py, pz) = one_enu_m, other_enu_m
    return hypot(x - px, y - py, 0.5 * (z - pz))


def off_m(body: Body, goal_enu_m: Vector3) -> float:
    return hypot(*(a - b for a, b in zip(body.position_enu_m, goal_enu_m, strict=True)))


def _fleet(ids: Iterable[int], separation_m: float, envelope: Envelope, obstacles: tuple[Obstacle, ...]) -> FleetConfig:
    members = tuple(FormationMember(i, Role.FOLLOWER, ZERO3) for i in ids)
    return FleetConfig(
        name="test",
        origin="indoor",
        vehicles=members,
        neighbours=EdgeNeighbours(()),
        law=LawSection(name="weighted"),
        separation_m=separation_m,
        envelope=envelope,
        obstacles=obstacles,
    )


RING = ((1, 2), (2, 3), (3, 4), (4, 1))


CHAIN = ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6))


BEACON_MAX_AGE_S = 0.25


def leaders_in(around: dict[int, Consensus]) -> list[int]:
    return [i for i, what in around.items() if what.lead.role is Role.LEADER]


class CooperatingFleet:
    """Vehicles in formation that receive all packets of the previous tick, except those in `deaf`.

    Vehicles in `dead` do not run. `receives(receiver, sender)` may replace the network, which loses nothing by default.
    A vehicle that loses its leader is in hold from the next tick on.
    """

    def __init__(
        self,
        edges: tuple[tuple[int, int], ...],
        may_lead: tuple[int, ...],
        successors: tuple[int, ...] = (),
        beacon_max_age_s: float = BEACON_MAX_AGE_S,
    ) -> None:
        self.edges, self.may_lead, self.successors = edges, may_lead, successors
        self.beacon_max_age_s = beacon_max_age_s
        self.ids = sorted({i for edge in edges for i in edge})
        self.vehicles = {i: self.started(i) for i in self.ids}
        self.packets: dict[int, PeerPacket] = {}
        self.deaf: set[int] = set()
        self.dead: set[int] = set()
        self.receives: Callable[[int, int], bool] = lambda _receiver, _sender: True
        self.forged: dict[int, PeerPacket] = {}  # by receiver: takes the place of its sender's packet in the next tick
        self.phases = dict.fromkeys(self.ids, FlightPhase.FORMATION)
        self.sessions = dict.fromkeys(self.ids, 1)
        self.now_s = 50.0
        self._led: set[int] = set()

    def started(self, vehicle_id: int) -> ConsensusStage:
        return ConsensusStage(
            vehicle_id,
            Leadership(vehicle_id, [1], self.may_lead),
            len(self.ids),
            PeerTable(vehicle_id, {i: i in self.may_lead for i in self.ids}, 42, 0.3, LIMITS, self.successors),
            EdgeRule(vehicle_id, self.edges),
            BeaconMonitor(self.beacon_max_age_s),
            Succession(vehicle_id, self.successors),
        )

    def tick(self) -> dict[int, Consensus]:
        self.now_s += TICK_S
        around = {
            i: vehicle.step(
                self.now_s,
                VehicleState(position_enu_m=ZERO3, position_time_s=self.now_s, armed=True),
                Flight(self.phases[i], in_formation=self.phases[i] is not FlightPhase.HOLD),
                self._received_by(i),
                fit_to_lead=self.phases[i] is FlightPhase.FORMATION,
            )
            for i, vehicle in self.vehicles.items()
            if i not in self.dead
        }
        for i, what in around.items():
            if what.lead.beacon is not None:
                self._led.add(i)
            elif (
                what.lead.leaderless is HealthFlag.LEADER_LOST
                and i in self._led
                and self.phases[i] is FlightPhase.FORMATION
            ):
                self.phases[i] = FlightPhase.HOLD
        self.packets, self.forged = {i: self._packet(i, what) for i, what in around.items()}, {}
        assert all(not vehicle.peers.rejected for vehicle in self.vehicles.values())
        return around

    def fly(self, ticks: int) -> dict[int, Consensus]:
        return [self.tick() for _ in range(ticks)][-1]

    def give(self, lead: Lead, *ids: int) -> None:
        for i in ids or self.ids:
            assert self.vehicles[i].leadership.command(lead)[0].accepted

    def _received_by(self, vehicle_id: int) -> list[ReceivedPeerPacket]:
        senders = [] if vehicle_id in self.deaf else [i for i in self.packets if i != vehicle_id]
        others = [self.packets[i] for i in senders if self.receives(vehicle_id, i)]
        if forged := self.forged.get(vehicle_id):
            others = [packet for packet in others if packet.sender.vehicle_id != forged.sender.vehicle_id] + [forged]
        return [ReceivedPeerPacket(self.now_s, packet) for packet in others]

    def _packet(self, vehicle_id: int, what: Consensus) -> PeerPacket:
        sequence = round(self.now_s / TICK_S)
        return replace(
            AT_REST,
            sender=Sender(vehicle_id, session=self.sessions[vehicle_id], sequence=sequence, formation_hash=42),
            phase=self.phases[vehicle_id],
            role=what.lead.role,
            motion=replace(AT_REST.motion, sent_s=self.now_s),
            leader=LeaderReport(prc=what.prc, beacon=what.lead.beacon),
        )
