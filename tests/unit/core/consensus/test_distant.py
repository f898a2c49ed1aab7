"""Which peers of a large fleet are received at 5 Hz, and what counts of them."""

from __future__ import annotations

from random import Random
from typing import Any

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.core.consensus.neighbours import (
    CHOICE_PERIOD_S,
    NONE,
    STATE_AGE_S,
    STEADY_S,
    UNTIL_FULL_RATE_S,
    DistantLimits,
    DistantPeers,
)
from companion.core.consensus.peers import DISTANT_MAX_AGE_S, FULL_RATE_WITHIN_S, FleetLimits, PeerState, PeerTable
from companion.types.autopilot import VehicleState
from companion.types.flight import Flight, FlightPhase, Role
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import LeaderReport, Motion, PeerPacket, ReceivedPeerPacket, Sender
from companion.types.values import ZERO3

BEACON = LeaderBeacon(1, 0, 20)
SLOT = FlownSlot((-10.0, 0.0, 0.0), formation=3, waiting=3)
FORMATION = Flight(FlightPhase.FORMATION, streams=True, in_formation=True, on_ground=False)
SEPARATION_M = 1.5
LIMITS = DistantLimits(frozenset({1, 2}), 0.0, SEPARATION_M, 4.5)
PACKET = PeerPacket(
    sender=Sender(vehicle_id=5, session=77, sequence=10, formation_hash=42),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion(
        position_enu_m=(100.0, 0.0, 0.0),
        velocity_enu_m_s=ZERO3,
        acceleration_enu_m_s2=ZERO3,
        state_age_s=0.0,
        sent_s=0.0,
    ),
    leader=LeaderReport(prc=2, beacon=BEACON),
    slot=SLOT,
)


class Choice:
    """The choice of a vehicle at the origin, every 20 ms, with peers whose packets are new each time."""

    def __init__(self, limits: DistantLimits = LIMITS) -> None:
        self.peers = DistantPeers(limits)
        self.now_s = 100.0
        self.slot, self.flight, self.beacon = SLOT, FORMATION, BEACON
        self.neighbour_ids: tuple[int, ...] = ()
        self.age_s = 0.0

    def after(self, seconds: float, **changes: Any) -> frozenset[int]:
        """The choice with a peer like PACKET with `changes`."""
        packet, ids = with_fields(PACKET, **changes), NONE
        for _ in range(round(seconds / 0.02)):
            self.now_s += 0.02
            measured_s = self.now_s - self.age_s
            peers = {packet.sender.vehicle_id: PeerState(packet, measured_s, 0.0, measured_s)}
            hears_leader = self.beacon is not None
            ids = self.peers.step(
                self.now_s, VehicleState(), self.flight, self.slot, hears_leader, self.neighbour_ids, peers
            )
        return ids


LONG_S = STEADY_S + 4 * CHOICE_PERIOD_S


def test_a_peer_far_away_in_steady_flight_is_distant_after_a_while() -> None:
    choice = Choice()
    assert choice.after(STEADY_S - CHOICE_PERIOD_S) == NONE
    assert choice.after(4 * CHOICE_PERIOD_S) == {5}


@pytest.mark.parametrize(
    "changes",
    [
        {"phase": FlightPhase.HOLD},
        {"phase": FlightPhase.ENGAGE},
        {"phase": FlightPhase.LAND},
        {"role": Role.LEADER},
        {"vehicle_id": 2},
        {"rft": (ZERO3, ZERO3, ZERO3)},
        {"slot": replace(SLOT, moves_for_s=1.0)},
        {"slot": replace(SLOT, waiting=4)},
        {"slot": replace(SLOT, formation=2, waiting=2)},
        {"position_enu_m": (8.0, 0.0, 0.0)},
        {"position_enu_m": (0.0, 0.0, 20.0)},  # heights count half
        {"velocity_enu_m_s": (-25.0, 0.0, 0.0)},
    ],
)
def test_any_other_peer_is_received_at_50_hz(changes: dict[str, Any]) -> None:
    choice = Choice()
    assert choice.after(LONG_S, **changes) == NONE
    known = Choice()
    assert known.after(LONG_S, vehicle_id=changes.get("vehicle_id", 5)) <= {5}
    assert known.after(CHOICE_PERIOD_S + 0.02, **changes) == NONE


def test_a_silent_peer_is_received_at_50_hz() -> None:
    choice = Choice()
    assert choice.after(LONG_S) == {5}
    choice.age_s = DISTANT_MAX_AGE_S + 0.01
    assert choice.after(CHOICE_PERIOD_S + 0.02) == NONE


def test_a_neighbour_is_received_at_50_hz() -> None:
    choice = Choice()
    choice.neighbour_ids = (5,)
    assert choice.after(LONG_S) == NONE


@pytest.mark.parametrize("what", ["phase", "slot", "waiting", "leader"])
def test_a_vehicle_that_is_not_steady_itself_receives_all_at_50_hz_at_once(what: str) -> None:
    choice = Choice()
    assert choice.after(LONG_S) == {5}
    match what:
        case "phase":
            choice.flight = Flight(FlightPhase.HOLD, on_ground=False)
        case "slot":
            choice.slot = replace(SLOT, moves_for_s=2.0)
        case "waiting":
            choice.slot = replace(SLOT, waiting=4)
        case "leader":
            choice.beacon = None  # type: ignore[assignment]
    assert choice.after(0.02) == NONE
    choice.flight, choice.slot, choice.beacon = FORMATION, SLOT, BEACON
    assert choice.after(STEADY_S - CHOICE_PERIOD_S) == NONE
    assert choice.after(5 * CHOICE_PERIOD_S) == {5}


def test_a_range_and_the_way_until_the_next_packets_stay_at_50_hz() -> None:
    limits = within_range(60.0)
    assert Choice(limits).after(LONG_S, position_enu_m=(62.0, 0.0, 0.0)) == NONE
    assert Choice(limits).after(LONG_S, position_enu_m=(80.0, 0.0, 0.0)) == {5}


def within_range(range_m: float) -> DistantLimits:
    return DistantLimits(NONE, range_m, SEPARATION_M, 4.5)


@pytest.mark.parametrize("age_s", [0.0, 0.4, 0.7, DISTANT_MAX_AGE_S])  # of the last state: one to four lost packets
@pytest.mark.parametrize("speed_m_s", [0.0, 3.0, 8.0])
def test_two_vehicles_that_turn_on_each_other_can_still_brake(speed_m_s: float, age_s: float) -> None:
    """Both accelerate at the tilt limit until the first packet at 50 Hz, then brake as the filter plans, with half of it."""
    distant_from_m = next(
        x / 10.0 for x in range(10_000) if is_distant_at(x / 10.0, age_s, velocity_enu_m_s=(-speed_m_s, 0.0, 0.0))
    )
    remains_m = 1e9
    until_s = UNTIL_FULL_RATE_S + max(0.0, age_s - STATE_AGE_S)
    # As near as a distant peer may be before it is received at 50 Hz again
    gap_m, towards_m_s, dt_s, t = distant_from_m / 1.2, speed_m_s, 0.001, 0.0
    while towards_m_s > 0.0 or t == 0.0:
        towards_m_s += dt_s * (2 * 4.5 if t < until_s else -4.5)
        gap_m, t = gap_m - dt_s * towards_m_s, t + dt_s
        remains_m = min(remains_m, gap_m)
    assert SEPARATION_M < remains_m < SEPARATION_M + 10.0


def is_distant_at(x_m: float, age_s: float, **changes: Any) -> bool:
    """Whether a peer is distant whose extrapolated position is this far away."""
    choice, flown_m = Choice(), age_s * changes["velocity_enu_m_s"][0]
    choice.age_s = age_s
    return choice.after(LONG_S, position_enu_m=(x_m - flown_m, 0.0, 0.0), **changes) != NONE


def test_a_peer_of_which_packets_are_lost_is_received_at_50_hz_from_farther_away() -> None:
    choice, at_m = Choice(), (20.0, 0.0, 0.0)
    assert choice.after(LONG_S, position_enu_m=at_m) == {5}
    choice.age_s = STATE_AGE_S
    assert choice.after(CHOICE_PERIOD_S + 0.02, position_enu_m=at_m) == {5}
    choice.age_s = 0.9
    assert choice.after(CHOICE_PERIOD_S + 0.02, position_enu_m=at_m) == NONE
    assert Choice().after(LONG_S, position_enu_m=(60.0, 0.0, 0.0)) == {5}


@pytest.mark.parametrize("seed", range(5))
def test_no_stream_of_packets_changes_the_rates_of_a_peer_more_than_once_in_2_s(seed: int) -> None:
    """Each change of a subscription takes 0.1 ms of a tick. Every tick another packet, hostile or true, is the newest."""
    choice, random = Choice(), Random(seed)
    hostile: tuple[dict[str, Any], ...] = (
        {"phase": FlightPhase.HOLD},
        {"role": Role.LEADER},
        {"slot": replace(SLOT, moves_for_s=1.0)},
        {"position_enu_m": (3.0, 0.0, 0.0)},
        {"velocity_enu_m_s": (25.0, 0.0, 0.0)},
        {"rft": (ZERO3, ZERO3, ZERO3)},
    )
    before, becomes_distant = NONE, 0
    for _ in range(60):
        for _ in range(random.randint(1, 160)):
            ids = choice.after(0.02)
            becomes_distant += len(ids - before)
            before = ids
        before = choice.after(0.02 * random.randint(1, 12), **random.choice(hostile))
    assert 1 <= becomes_distant <= (choice.now_s - 100.0) / STEADY_S


def table() -> PeerTable:
    limits = FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0))
    return PeerTable(3, {1: True, 5: False, 3: False}, 42, 0.3, limits, ())


def receive(peers: PeerTable, now_s: float, **changes: Any) -> None:
    packet = with_fields(PACKET, sequence=round(50 * now_s), sent_s=now_s, **changes)
    peers.fold([ReceivedPeerPacket(now_s, packet)], epochs_up_to=100)


def test_a_distant_peer_is_present_for_longer_but_never_fresh() -> None:
    peers = table()
    receive(peers, 10.0)
    assert peers.in_time(10.0)[1].keys() == {5}
    peers.set_low_rate_peers(10.02, frozenset({5}))
    for now_s, present in ((10.02, {5}), (10.35, {5}), (10.99, {5}), (11.02, set())):
        assert peers.in_time(now_s)[0] == {}
        assert peers.in_time(now_s)[1].keys() == present


def test_a_peer_that_is_no_longer_distant_is_missed_only_after_its_first_packets_were_due() -> None:
    peers = table()
    receive(peers, 10.0)
    peers.set_low_rate_peers(10.0, frozenset({5}))
    peers.set_low_rate_peers(10.35, NONE)
    assert peers.in_time(10.4)[0] == {}
    assert peers.in_time(10.4)[1].keys() == {5}
    peers.set_low_rate_peers(10.02 + FULL_RATE_WITHIN_S, NONE)
    assert peers.in_time(10.02 + FULL_RATE_WITHIN_S)[1] == {}


def test_packets_at_5_hz_are_in_order_and_may_jump_no_farther() -> None:
    peers = table()
    for k in range(20):
        peers.set_low_rate_peers(10.0 + 0.2 * k, frozenset({5}))
        if k % 3:  # one in three is lost
            receive(peers, 10.0 + 0.2 * k)
    assert not peers.rejected
    receive(peers, 14.0, session=78)
    assert set(peers.rejected) == {f"{Code.PEER_ID_TWICE} 5"}
    receive(peers, 14.0, position_enu_m=(190.0, 0.0, 0.0))
    assert f"{Code.PEER_POSITION_JUMPED} 5" in peers.rejected
