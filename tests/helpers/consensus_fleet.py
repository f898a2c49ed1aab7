"""A fleet of consensus stages, tick by tick, without flight, and packets of peers in their slots."""

from __future__ import annotations

from collections.abc import Callable

from common import with_fields
from companion.core.consensus.neighbours import EdgeRule
from companion.core.consensus.peers import FleetLimits, PeerState, PeerTable
from companion.core.consensus.stage import Consensus, ConsensusStage
from companion.core.election.beacon import BeaconMonitor
from companion.core.election.leadership import Leadership, Succession
from companion.types.autopilot import PositionError, VehicleState
from companion.types.commands import Lead
from companion.types.flight import Flight, FlightPhase, HealthFlag, Role
from companion.types.formation import FlownSlot
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedPeerPacket, Sender
from companion.types.values import ZERO3, Vector3

TICK_S = 0.02
RING = ((1, 2), (2, 3), (3, 4), (4, 1))
CHAIN = ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6))
BEACON_MAX_AGE_S = 0.25


def leaders_in(around: dict[int, Consensus]) -> list[int]:
    return [i for i, what in around.items() if what.lead.role is Role.LEADER]


LIMITS = FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0))


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
                VehicleState(position_enu_m=ZERO3, armed=True),
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
        return PeerPacket(
            sender=Sender(
                vehicle_id=vehicle_id,
                session=self.sessions[vehicle_id],
                sequence=round(self.now_s / TICK_S),
                formation_hash=42,
            ),
            phase=self.phases[vehicle_id],
            role=what.lead.role,
            motion=Motion(
                position_enu_m=ZERO3,
                velocity_enu_m_s=ZERO3,
                acceleration_enu_m_s2=ZERO3,
                state_age_s=0.0,
                sent_s=self.now_s,
            ),
            leader=LeaderReport(prc=what.prc, beacon=what.lead.beacon),
            slot=FlownSlot(ZERO3),
        )


PEER_SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
FLEET: Vector3 = (10.0, 0.0, 5.0)
NOW_S = 100.0


def peer(vehicle_id: int, moves_m_s: Vector3 = ZERO3, **changes: object) -> PeerState:
    x, y, z = (r + d for r, d in zip(FLEET, PEER_SLOTS[vehicle_id], strict=True))
    packet = PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=1, sequence=1, formation_hash=0),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=(x, y, z),
            velocity_enu_m_s=moves_m_s,
            acceleration_enu_m_s2=ZERO3,
            state_age_s=0.0,
            sent_s=0.0,
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot(PEER_SLOTS[vehicle_id]),
    )
    return PeerState(with_fields(packet, **changes), NOW_S, NOW_S, NOW_S)


SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.0, 0.0, 0.0), 4: (-3.0, 0.0, 1.0)}


def slot_peer(vehicle_id: int, z_m: float = 0.0, error: PositionError | None = None, air: bool = False) -> PeerPacket:
    phase = FlightPhase.HOLD if air else FlightPhase.READY
    at, zero = (3.0 * vehicle_id - 6.0, 0.0, z_m), (0.0, 0.0, 0.0)
    return PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=1, sequence=1, formation_hash=0),
        phase=phase,
        role=Role.FOLLOWER,
        motion=Motion(
            position_enu_m=at, velocity_enu_m_s=zero, acceleration_enu_m_s2=zero, state_age_s=0.0, sent_s=0.0
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=FlownSlot(SLOTS[vehicle_id]),
        position_error=error,
    )
