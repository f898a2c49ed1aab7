"""A fleet of Cooperations tick by tick: who leads, what is heard of it, and nothing of how they fly."""

from __future__ import annotations

from collections.abc import Callable

from companion.core.cooperation import Cooperation, Neighbourhood
from companion.core.leader_word import LeaderWatch
from companion.core.leadership import Leadership
from companion.core.neighbours import EdgeRule
from companion.core.peers import PeerTable
from companion.core.succession import Succession
from companion.types import ZERO3, FlightPhase, FlownSlot, HealthFlag, Lead, PeerPacket, ReceivedPeerPacket, Role

TICK_S = 0.02
RING = ((1, 2), (2, 3), (3, 4), (4, 1))
CHAIN = ((1, 2), (2, 3), (3, 4), (4, 5), (5, 6))
WORD_MAX_AGE_S = 0.25


def leaders_in(around: dict[int, Neighbourhood]) -> list[int]:
    return [i for i, what in around.items() if what.role is Role.LEADER]


class Fleet:
    """Vehicles in formation that hear all packets of the tick before, but for those that `deaf` names.

    Those in `dead` neither think nor speak. `hears(receiver, sender)` may be put in the place of a network that loses nothing.
    Who had a leader, and then none for too long, is in hold from the next tick on.
    """

    def __init__(
        self, edges: tuple[tuple[int, int], ...], may_lead: tuple[int, ...], successors: tuple[int, ...] = ()
    ) -> None:
        self.edges, self.may_lead, self.successors = edges, may_lead, successors
        self.ids = sorted({i for edge in edges for i in edge})
        self.vehicles = {i: self.started(i) for i in self.ids}
        self.packets: dict[int, PeerPacket] = {}
        self.deaf: set[int] = set()
        self.dead: set[int] = set()
        self.hears: Callable[[int, int], bool] = lambda _receiver, _sender: True
        self.phases = dict.fromkeys(self.ids, FlightPhase.FORMATION)
        self.sessions = dict.fromkeys(self.ids, 1)
        self.now_s = 50.0
        self._led: set[int] = set()

    def started(self, vehicle_id: int) -> Cooperation:
        return Cooperation(
            vehicle_id,
            Leadership(vehicle_id, [1], self.may_lead),
            len(self.ids),
            PeerTable(vehicle_id, {i: i in self.may_lead for i in self.ids}, 42, 0.3, 25.0, self.successors),
            EdgeRule(vehicle_id, self.edges),
            LeaderWatch(WORD_MAX_AGE_S),
            Succession(vehicle_id, self.successors),
        )

    def tick(self) -> dict[int, Neighbourhood]:
        self.now_s += TICK_S
        around = {
            i: vehicle.update(
                self.now_s,
                ZERO3,
                self._heard_by(i),
                self.phases[i] is not FlightPhase.HOLD,
                self.phases[i] is FlightPhase.FORMATION,
            )
            for i, vehicle in self.vehicles.items()
            if i not in self.dead
        }
        for i, what in around.items():
            if what.leader_word is not None:
                self._led.add(i)
            elif (
                what.leaderless is HealthFlag.LEADER_LOST and i in self._led and self.phases[i] is FlightPhase.FORMATION
            ):
                self.phases[i] = FlightPhase.HOLD
        self.packets = {i: self._packet(i, what) for i, what in around.items()}
        assert all(not vehicle.peers.rejected for vehicle in self.vehicles.values())
        return around

    def fly(self, ticks: int) -> dict[int, Neighbourhood]:
        return [self.tick() for _ in range(ticks)][-1]

    def give(self, lead: Lead, *ids: int) -> None:
        for i in ids or self.ids:
            assert self.vehicles[i].leadership.obey(lead)[0]

    def _heard_by(self, vehicle_id: int) -> list[ReceivedPeerPacket]:
        heard = [] if vehicle_id in self.deaf else [i for i in self.packets if i != vehicle_id]
        others = [self.packets[i] for i in heard if self.hears(vehicle_id, i)]
        return [ReceivedPeerPacket(self.now_s, packet) for packet in others]

    def _packet(self, vehicle_id: int, what: Neighbourhood) -> PeerPacket:
        return PeerPacket(
            vehicle_id=vehicle_id,
            session=self.sessions[vehicle_id],
            sequence=round(self.now_s / TICK_S),
            formation_hash=42,
            phase=self.phases[vehicle_id],
            role=what.role,
            position_enu_m=ZERO3,
            velocity_enu_m_s=ZERO3,
            acceleration_enu_m_s2=ZERO3,
            state_age_s=0.0,
            sent_s=self.now_s,
            prc=what.prc,
            leader_word=what.leader_word,
            slot=FlownSlot(ZERO3),
        )
