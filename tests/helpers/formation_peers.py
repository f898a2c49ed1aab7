"""States of peers in a formation at rest or in motion."""

from __future__ import annotations

from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import PeerPacket
from companion.types.values import ZERO3, Vector3

SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
FLEET: Vector3 = (10.0, 0.0, 5.0)
NOW_S = 100.0


def peer(vehicle_id: int, moves_m_s: Vector3 = ZERO3, **changes: object) -> PeerState:
    x, y, z = (r + d for r, d in zip(FLEET, SLOTS[vehicle_id], strict=True))
    packet = PeerPacket(
        vehicle_id=vehicle_id,
        session=1,
        sequence=1,
        formation_hash=0,
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        position_enu_m=(x, y, z),
        velocity_enu_m_s=moves_m_s,
        acceleration_enu_m_s2=ZERO3,
        state_age_s=0.0,
        sent_s=0.0,
        prc=2,
        leader_beacon=None,
        slot=FlownSlot(SLOTS[vehicle_id]),
    )
    return PeerState(replace(packet, **changes), NOW_S, NOW_S, NOW_S)
