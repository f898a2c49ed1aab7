"""Wrong packets of a neighbour, as wrong as the checks let them be, move no vehicle in formation far, and none for long."""

from __future__ import annotations

from copy import deepcopy
from itertools import combinations
from math import dist, hypot
from random import Random

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.types.commands import CommandName
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.notices import Code
from companion.types.peers import PeerPacket
from companion.types.values import Vector3
from tests.fuzz.fleet import Hostile, HostileFleet
from tests.fuzz.plant import TICK_S

LEADER, FOLLOWER = 1, 2
MOST_M, GONE_M, GONE_AFTER_S = 0.6, 0.05, 12.0
SEEDS = range(2)  # `weighted` and `cooperative`, on a circle
STREAM_S = 6.0
SUCCEEDED_M = 0.4  # vehicles lag behind a circling reference by other distances about another leader
CARRIED_M = 12.0  # by a stream, most where the leader that is not believed any more is succeeded; it was 99 m
FAR, FAST, HARD = 4.5, 25.0, 13.0  # of a jump, speed and acceleration: a little below what is refused


def along(axis: int, size: float) -> Vector3:
    x, y, z = (size if i == axis else 0.0 for i in range(3))
    return (x, y, z)


def wrong(packet: PeerPacket, what: str, axis: int, sign: float) -> PeerPacket:
    moved = along(axis, sign * FAR)
    x, y, z = (a + b for a, b in zip(packet.motion.position_enu_m, moved, strict=True))
    packet = with_fields(packet, sequence=packet.sender.sequence + 1)
    match what:
        case "position":
            return with_fields(packet, position_enu_m=(x, y, z))
        case "velocity":
            return with_fields(packet, velocity_enu_m_s=along(axis, sign * 0.99 * FAST))
        case "acceleration":
            return with_fields(packet, acceleration_enu_m_s2=along(axis, sign * 99.0))
        case "all":
            motion = (along(axis, sign * 0.99 * FAST), along(axis, sign * HARD))
            return with_fields(
                packet, position_enu_m=(x, y, z), velocity_enu_m_s=motion[0], acceleration_enu_m_s2=motion[1]
            )
        case "slot":
            slot = with_fields(packet.slot, position_enu_m=along(axis, -sign * (390.0 if axis < 2 else 100.0)))
            return replace(packet, slot=slot)
        case "rft":
            rft = (along(axis, sign * 19_999.0), along(axis, sign * 0.99 * FAST), along(axis, sign * 99.0))
            return replace(packet, rft=rft)
        case _:
            return with_fields(packet, state_age_s=9.9)


@pytest.fixture(scope="module", params=SEEDS)
def settled(request: pytest.FixtureRequest) -> HostileFleet:
    fleet = HostileFleet(Random(request.param))
    for _ in range(10):
        fleet.tick()
    for name in (CommandName.PREPARE, CommandName.ARM, CommandName.TAKEOFF, CommandName.FORM):
        assert all(reply.accepted for reply in fleet.command(name).values())
        for _ in range(900 if name is CommandName.FORM else 100):
            fleet.tick()
    assert {agent.phase for agent in fleet.agents.values()} == {FlightPhase.FORMATION}
    return fleet


def flown(fleet: HostileFleet, forged: PeerPacket | None) -> list[Vector3]:
    """Positions of the follower, in each tick after this packet."""
    positions = []
    for tick in range(round(GONE_AFTER_S / TICK_S)):
        hostile = Hostile([forged]) if forged and tick == 0 else Hostile()
        fleet.tick({i: hostile if i == FOLLOWER else Hostile() for i in fleet.agents})
        positions.append(fleet.plants[FOLLOWER].position_enu_m)
    return positions


@pytest.mark.parametrize("what", ["position", "velocity", "acceleration", "all", "slot", "rft", "age"])
def test_one_wrong_packet_moves_a_follower_a_little_and_not_for_long(settled: HostileFleet, what: str) -> None:
    """The separation filter may act on it, and then the follower counts as kept off its slot for 4 s."""
    undisturbed = flown(deepcopy(settled), None)
    for axis, sign in ((0, -1.0), (0, 1.0)):
        fleet = deepcopy(settled)
        disturbed = flown(fleet, wrong(fleet.packets[1], what, axis, sign))
        moved_m = [dist(a, b) for a, b in zip(disturbed, undisturbed, strict=True)]
        assert max(moved_m) < MOST_M, (axis, sign)
        assert moved_m[-1] < GONE_M, (axis, sign)
        assert fleet.agents[FOLLOWER].phase is FlightPhase.FORMATION


def carried(fleet: HostileFleet, liar: int | None, claimed_enu_m_s2: Vector3) -> list[dict[int, Vector3]]:
    """Positions in each tick while this vehicle claims an acceleration for 6 s, and for 12 s afterwards.

    `tick` itself judges the tilt of every setpoint.
    """
    envelope, positions = fleet.config.envelope, []
    fastest_m_s = hypot(envelope.max_speed_m_s, max(envelope.max_climb_m_s, envelope.max_descent_m_s))
    for tick in range(round((STREAM_S + GONE_AFTER_S) / TICK_S)):
        if liar and tick < round(STREAM_S / TICK_S):
            fleet.packets[liar] = with_fields(fleet.packets[liar], acceleration_enu_m_s2=claimed_enu_m_s2)
        fleet.tick()
        for plant in fleet.plants.values():
            assert hypot(*plant.velocity_enu_m_s) <= fastest_m_s
        positions.append({i: plant.position_enu_m for i, plant in fleet.plants.items()})
    return positions


@pytest.mark.parametrize("claimed_enu_m_s2", [along(0, 99.0), along(0, -99.0), along(1, 99.0), along(2, 99.0)], ids=str)
@pytest.mark.parametrize("liar", [LEADER, FOLLOWER])
def test_a_stream_of_claimed_accelerations_carries_no_vehicle_away(
    settled: HostileFleet, liar: int, claimed_enu_m_s2: Vector3
) -> None:
    """Used as the fleet can fly at most, until the velocities contradict it. Such a leader is succeeded."""
    undisturbed = carried(deepcopy(settled), None, claimed_enu_m_s2)
    fleet = deepcopy(settled)
    disturbed = carried(fleet, liar, claimed_enu_m_s2)
    for i in fleet.agents:
        moved_m = [dist(a[i], b[i]) for a, b in zip(disturbed, undisturbed, strict=True)]
        assert max(moved_m) < CARRIED_M
        assert moved_m[-1] < (SUCCEEDED_M if liar == LEADER else GONE_M)
    distances_m = [dist(at[i], at[j]) for at in disturbed for i, j in combinations(at, 2)]
    assert min(distances_m) >= fleet.config.separation_m
    assert {agent.phase for agent in fleet.agents.values()} == {FlightPhase.FORMATION}
    leaders = [i for i, status in fleet.statuses.items() if status.leadership.role is Role.LEADER]
    assert leaders == [FOLLOWER if liar == LEADER else LEADER]
    for i in fleet.agents.keys() - {liar}:
        assert fleet.statuses[i].rejected[f"{Code.PEER_ACCELERATION_LIMITED} {liar}"] == round(STREAM_S / TICK_S)


VELOCITIES_S, MOVED_M = 8.0, 1.0
JUMPED_M = 3.0


def deceived(fleet: HostileFleet, liar: int, jumps: bool) -> list[dict[int, Vector3]]:
    """Positions in each tick while this vehicle sends +-11.9 m/s in turn, or positions that jump to and fro each second."""
    positions = []
    for tick in range(round(VELOCITIES_S / TICK_S)):
        packet = fleet.packets[liar]
        if jumps:
            x, y, z = packet.motion.position_enu_m
            moved_m = JUMPED_M if tick * TICK_S % 2.0 >= 1.0 else 0.0
            fleet.packets[liar] = with_fields(packet, position_enu_m=(x, y, z + moved_m))
        else:
            fleet.packets[liar] = with_fields(packet, velocity_enu_m_s=along(0, 11.9 if tick % 2 else -11.9))
        fleet.tick()
        positions.append({i: plant.position_enu_m for i, plant in fleet.plants.items()})
    return positions


@pytest.mark.parametrize("liar", [LEADER, FOLLOWER])
def test_velocities_that_the_positions_contradict_move_no_vehicle_far(settled: HostileFleet, liar: int) -> None:
    """It was 4.0 m and 5.4 m, and 15 m where followers confirmed the false velocity to each other."""
    undisturbed = carried(deepcopy(settled), None, along(0, 0.0))
    fleet = deepcopy(settled)
    disturbed = deceived(fleet, liar, jumps=False)
    for i in fleet.agents:
        assert max(dist(a[i], b[i]) for a, b in zip(disturbed, undisturbed, strict=False)) < MOVED_M
    for i in fleet.agents.keys() - {liar}:
        assert HealthFlag.PEER_IN_DOUBT in fleet.statuses[i].safety.flags
        assert fleet.statuses[i].rejected[f"{Code.PEER_IN_DOUBT} {liar}"] > 0
        assert liar not in fleet.statuses[i].neighbourhood.neighbours


@pytest.mark.parametrize("liar", [LEADER, FOLLOWER])
def test_a_position_that_jumps_each_second_is_not_followed(settled: HostileFleet, liar: int) -> None:
    fleet = deepcopy(settled)
    positions = deceived(fleet, liar, jumps=True)
    for i in fleet.agents.keys() - {liar}:
        assert HealthFlag.PEER_IN_DOUBT in fleet.statuses[i].safety.flags
        assert liar not in fleet.statuses[i].neighbourhood.neighbours
    distances_m = [dist(at[i], at[j]) for at in positions for i, j in combinations(at, 2)]
    assert min(distances_m) >= fleet.config.separation_m
