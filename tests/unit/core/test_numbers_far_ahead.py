"""One vehicle with a number or an epoch far ahead: its position is used, and the next command of the operator reaches all."""

from __future__ import annotations

from itertools import accumulate
from random import Random

import pytest

from common import with_fields
from companion.ground.changes import change_to, reference_change
from companion.types.commands import NUMBERS_AHEAD, CommandName, Lead, ReferenceChange, next_epoch
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FormationChange, LeaderBeacon
from companion.types.peers import PeerPacket
from tests.fuzz.fleet import ANSWERED_WITHIN, Hostile, HostileFleet

C = CommandName
POINT = {"kind": "point", "point_enu_m": [0.0, 0.0, 5.0]}
WRONG = 2  # the vehicle that obeys wrong commands


def ticks(fleet: HostileFleet, number: int) -> None:
    for _ in range(number):
        fleet.tick()


def fleet_in(phase: FlightPhase, seed: int = 0) -> HostileFleet:
    fleet = HostileFleet(Random(seed))
    ticks(fleet, 10)
    steps = {FlightPhase.OBSERVE: 0, FlightPhase.HOLD: 3, FlightPhase.FORMATION: 4}[phase]
    for name in (C.PREPARE, C.ARM, C.TAKEOFF, C.FORM)[:steps]:
        assert all(reply.accepted for reply in fleet.command(name).values())
        ticks(fleet, 100 if name is C.TAKEOFF else 60)
    assert {agent.phase for agent in fleet.agents.values()} == {phase}
    return fleet


def wrongly_commanded(
    fleet: HostileFleet, name: CommandName, content: Lead | FormationChange | ReferenceChange
) -> None:
    fleet.replies.clear()
    fleet.give(WRONG, name, content)
    for _ in range(ANSWERED_WITHIN):
        fleet.tick()
        if WRONG in fleet.replies:
            break
    assert fleet.replies[WRONG].accepted, fleet.replies[WRONG].reason


def slots_of(fleet: HostileFleet, scale: float) -> dict[int, tuple[float, float, float]]:
    return {m.id: (m.slot_enu_m[0] * scale, 0.0, 0.0) for m in fleet.config.vehicles}


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.HOLD, FlightPhase.FORMATION])
@pytest.mark.parametrize("steps", [[8] * 7, [999], [NUMBERS_AHEAD] * 3])
def test_repeated_lead_commands_to_one_vehicle_lock_nothing(phase: FlightPhase, steps: list[int]) -> None:
    fleet = fleet_in(phase)
    epochs = list(accumulate(steps))
    for epoch in epochs:  # no peer follows while the vehicle is not leader
        wrongly_commanded(fleet, C.LEAD, Lead((1,), epoch))
    wrongly_commanded(fleet, C.LEAD, Lead((WRONG,), epochs[-1] + 1))
    for _ in range(150):
        fleet.tick()
        for i, status in fleet.statuses.items():
            assert set(status.neighbourhood.peers) == fleet.agents.keys() - {i}
    lead = Lead((1,), next_epoch(status.leadership.epoch for status in fleet.statuses.values()))
    assert all(reply.accepted for reply in fleet.command(C.LEAD, lead).values())
    ticks(fleet, 50)
    assert {status.leadership.epoch for status in fleet.statuses.values()} == {lead.epoch}


@pytest.mark.parametrize("commands", [1, 2, 3])
def test_a_formation_number_far_ahead_at_one_vehicle_locks_nothing(commands: int) -> None:
    fleet = fleet_in(FlightPhase.OBSERVE)
    for number in range(1, commands + 1):
        slots = tuple(slots_of(fleet, 1.0 + 0.1 * number).items())
        wrongly_commanded(fleet, C.FORMATION, FormationChange(NUMBERS_AHEAD * number, slots, 1.0, 10.0))
    change = change_to(slots_of(fleet, 1.5), list(fleet.statuses.values()), 1.0)
    assert all(reply.accepted for reply in fleet.command(C.FORMATION, change).values())
    ticks(fleet, 10)
    assert {status.formation.slot.formation for status in fleet.statuses.values()} == {change.number}


def test_a_reference_far_ahead_that_waits_at_one_vehicle_locks_nothing() -> None:
    """In hold mission time is stopped: it would wait until the fleet forms."""
    fleet = fleet_in(FlightPhase.HOLD)
    wrongly_commanded(fleet, C.REFERENCE, ReferenceChange(NUMBERS_AHEAD, POINT, 60.0))
    change = reference_change(POINT, list(fleet.statuses.values()))
    replies = fleet.command(C.REFERENCE, change)
    assert replies[1].accepted
    assert replies[WRONG].accepted
    ticks(fleet, 10)
    held = [fleet.statuses[i].formation.reference for i in (1, WRONG)]
    assert [reference.waiting for reference in held if reference] == [change.number, change.number]


@pytest.mark.parametrize("phase", [FlightPhase.OBSERVE, FlightPhase.HOLD, FlightPhase.FORMATION])
def test_a_forged_mission_time_moves_no_clock(phase: FlightPhase) -> None:
    """One packet of each other vehicle. A stopped clock took it over, and the operator's next changes began too late."""
    fleet = fleet_in(phase)
    forged = {}
    for i in fleet.agents:
        others = [packet for j, packet in fleet.packets.items() if j != i]
        forged[i] = Hostile([with_mission_time(packet, fleet.now_s, 9e5) for packet in others])
    fleet.tick(forged)
    for _ in range(100):
        assert all(status.formation.reference_s < 100.0 for status in fleet.statuses.values())
        fleet.tick()


def with_mission_time(packet: PeerPacket, now_s: float, reference_s: float) -> PeerPacket:
    beacon = LeaderBeacon(2, 0, int(now_s * 1000), reference_s)
    return with_fields(packet, sequence=packet.sender.sequence + 1, beacon=beacon, role=Role.FOLLOWER, prc=2)
