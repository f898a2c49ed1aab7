"""Packets of peers in the slots of a column."""

from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import PeerPacket
from companion.types.values import Vector3

SLOTS: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-1.5, 0.0, 0.0), 3: (-3.0, 0.0, 0.0), 4: (-3.0, 0.0, 1.0)}


def peer(vehicle_id: int, z_m: float = 0.0, error: PositionError | None = None, air: bool = False) -> PeerPacket:
    phase = FlightPhase.HOLD if air else FlightPhase.READY
    at, zero = (3.0 * vehicle_id - 6.0, 0.0, z_m), (0.0, 0.0, 0.0)
    return PeerPacket(
        vehicle_id,
        1,
        1,
        0,
        phase,
        Role.FOLLOWER,
        at,
        zero,
        zero,
        0.0,
        0.0,
        2,
        None,
        FlownSlot(SLOTS[vehicle_id]),
        error,
    )
