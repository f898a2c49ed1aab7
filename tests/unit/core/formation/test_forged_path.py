"""A wrong duration in packets while vehicles enter formation: they form in seconds all the same.

A path into the slot is flown to its end. While it is, formation changes and joining are refused.
"""

from __future__ import annotations

from random import Random

import pytest

from common import with_fields
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase
from companion.types.peers import PeerPacket
from tests.fuzz.fleet import Hostile, HostileFleet

C, P = CommandName, FlightPhase
FORMED_WITHIN_S = 20.0  # undisturbed 10 s at most


def fleet_in_hold(offset_m: float) -> HostileFleet:
    """The last vehicle holds this far beside the place of its slot."""
    fleet = HostileFleet(Random(0))
    plant = fleet.plants[3]
    x, y, z = plant.position_enu_m
    plant.position_enu_m = (x, y + offset_m, z)
    for _ in range(10):
        fleet.tick()
    for name in (C.PREPARE, C.ARM, C.TAKEOFF):
        assert all(reply.accepted for reply in fleet.command(name).values())
        for _ in range(100):
            fleet.tick()
    assert {agent.phase for agent in fleet.agents.values()} == {P.HOLD}
    return fleet


def longest_path_s(fleet: HostileFleet) -> float:
    return max(status.formation.slot.moves_for_s for status in fleet.statuses.values())


def with_duration(packet: PeerPacket, moves_for_s: float) -> PeerPacket:
    slot = with_fields(packet.slot, moves_for_s=moves_for_s, velocity_enu_m_s=(0.0, 1e-6, 0.0))
    return with_fields(packet, sequence=packet.sender.sequence + 1, slot=slot)


@pytest.mark.parametrize("offset_m", [0.0, 5.0])
@pytest.mark.parametrize("sender", [1, 3])
def test_a_forged_duration_of_a_path_makes_no_other_path_long(offset_m: float, sender: int) -> None:
    fleet = fleet_in_hold(offset_m)
    for i in fleet.agents:
        fleet.give(i, C.FORM)
    for _ in range(60):  # a forged packet behind each true one, until all are in formation
        forged = Hostile([with_duration(fleet.packets[sender], 600.0)])
        fleet.tick({i: forged if i != sender else Hostile() for i in fleet.agents})
    assert {agent.phase for agent in fleet.agents.values()} == {P.FORMATION}
    for _ in range(25):
        fleet.tick()
    assert longest_path_s(fleet) < FORMED_WITHIN_S
