"""A vehicle that fell silent in the air, told to one whose agent started later."""

from __future__ import annotations

from math import inf, nan

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.core.consensus.peers import LOST_AFTER_S, FleetLimits, PeerTable
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import (
    FORGOTTEN_S,
    MOST_LOST,
    LeaderReport,
    LostVehicle,
    Motion,
    PeerPacket,
    ReceivedPeerPacket,
    Sender,
)

MAY_LEAD = dict.fromkeys(range(1, 21), False)
LIMITS = FleetLimits(25.0, 8.0, (200.0, 200.0, 55.0))
PACKET = PeerPacket(
    sender=Sender(vehicle_id=2, session=77, sequence=1, formation_hash=42),
    phase=FlightPhase.FORMATION,
    role=Role.FOLLOWER,
    motion=Motion((1.0, 2.0, 3.0), (0.5, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0, 100.0),
    leader=LeaderReport(prc=2, beacon=None),
    slot=FlownSlot((0.0, 0.0, 0.0)),
)
DEAD = LostVehicle(4, (5.0, 6.0, 7.0), (0.1, 0.2, 0.3), 12.5)


def table(own_id: int) -> PeerTable:
    return PeerTable(own_id, MAY_LEAD, 42, 0.3, LIMITS, ())


def told(own_id: int, *lost: LostVehicle) -> PeerTable:
    peers = table(own_id)
    peers.fold([ReceivedPeerPacket(100.0, replace(PACKET, lost=lost))], 8)
    assert 2 in peers.known
    assert not peers.rejected
    return peers


def packet_of(vehicle_id: int, armed: bool = True) -> ReceivedPeerPacket:
    return ReceivedPeerPacket(100.0, with_fields(PACKET, vehicle_id=vehicle_id, armed=armed))


def test_it_is_told_after_two_seconds_and_until_its_battery_is_empty() -> None:
    peers = table(3)
    peers.fold([packet_of(4), packet_of(5, armed=False)], 8)
    assert peers.lost(100.0 + LOST_AFTER_S) == ()
    assert peers.lost(110.0) == (LostVehicle(4, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 10.0),)
    assert peers.lost(100.0 + FORGOTTEN_S) == ()


def test_of_many_the_newest_are_told() -> None:
    peers = table(3)
    for vehicle_id in range(4, 20):
        received = packet_of(vehicle_id)
        peers.fold([replace(received, received_s=100.0 + vehicle_id)], 8)
    assert [lost.vehicle_id for lost in peers.lost(200.0)] == list(range(19, 19 - MOST_LOST, -1))


def test_the_one_that_is_told_knows_it_as_silent_and_tells_it_on() -> None:
    peers = told(3, DEAD)
    fresh, present = peers.in_time(100.1)
    assert 4 not in fresh
    assert 4 not in present
    known = peers.known[4]
    assert known.packet.motion.position_enu_m == DEAD.position_enu_m
    assert known.measured_s == 87.5
    assert known.packet.armed
    assert (
        peers.lost(110.0) == (replace(DEAD, age_s=22.5), LostVehicle(2, (1.0, 2.0, 3.0), (0.5, 0.0, 0.0), 10.0))[::-1]
    )


@pytest.mark.parametrize(
    "lie",
    [
        replace(DEAD, vehicle_id=3),  # the vehicle itself
        replace(DEAD, vehicle_id=200),
        replace(DEAD, age_s=0.5),  # one that sends is heard
        replace(DEAD, velocity_enu_m_s=(30.0, 0.0, 0.0)),
        replace(DEAD, velocity_enu_m_s=(nan, 0.0, 0.0)),
        replace(DEAD, velocity_enu_m_s=(0.0, inf, 0.0)),
    ],
)
def test_what_cannot_be_is_not_taken(lie: LostVehicle) -> None:
    assert list(told(3, lie).known) == [2]


def test_nobody_speaks_for_a_vehicle_that_was_heard_itself() -> None:
    peers = table(3)
    peers.fold([packet_of(4)], 8)
    before = peers.known[4]
    peers.fold([ReceivedPeerPacket(100.0, replace(PACKET, lost=(DEAD,)))], 8)
    assert peers.known[4] is before


def test_the_same_news_again_changes_nothing_and_its_own_packet_replaces_it() -> None:
    peers = told(3, DEAD)
    again = with_fields(PACKET, sequence=2, sent_s=100.02, lost=(replace(DEAD, position_enu_m=(0.0, 0.0, 0.0)),))
    peers.fold([ReceivedPeerPacket(100.02, again)], 8)
    assert peers.known[4].packet.motion.position_enu_m == DEAD.position_enu_m
    own = with_fields(PACKET, vehicle_id=4, position_enu_m=(50.0, 0.0, 3.0))
    peers.fold([ReceivedPeerPacket(100.1, own)], 8)
    assert peers.known[4].packet is own
    assert 4 in peers.in_time(100.1)[0]


def test_who_lost_contact_early_does_not_hide_where_others_heard_it_last() -> None:
    early = replace(DEAD, position_enu_m=(900.0, 0.0, 0.0), age_s=FORGOTTEN_S - 0.1)
    peers = told(3, early)
    witness = with_fields(PACKET, vehicle_id=5, sent_s=100.02, lost=(DEAD,))
    peers.fold([ReceivedPeerPacket(100.02, witness)], 8)
    assert peers.known[4].packet.motion.position_enu_m == DEAD.position_enu_m
    assert peers.lost(101.0)[0].vehicle_id == 4


def test_some_that_tell_each_other_keep_no_news_young() -> None:
    """Each hop adds its delay to the time of the state, as the age counts from its sending."""
    ring = [told(i, DEAD) if i == 3 else table(i) for i in (3, 5)]
    for step in range(1, 400):
        teller, listener = ring[step % 2], ring[(step + 1) % 2]
        now_s, sender = 100.0 + 0.1 * step, (3, 5)[step % 2]
        packet = with_fields(
            PACKET, vehicle_id=sender, sequence=step, sent_s=now_s - 0.1, lost=teller.lost(now_s - 0.1)
        )
        listener.fold([ReceivedPeerPacket(now_s, packet)], 8)
    assert max(peers.known[4].measured_s for peers in ring) < 100.0 - DEAD.age_s + 0.3


def test_invented_vehicles_do_not_displace_one_that_was_heard() -> None:
    peers = table(3)
    peers.fold([packet_of(4)], 8)
    invented = tuple(replace(DEAD, vehicle_id=i, age_s=2.0) for i in range(10, 10 + MOST_LOST))
    peers.fold([ReceivedPeerPacket(150.0, with_fields(PACKET, sent_s=150.0, lost=invented))], 8)
    assert 4 in [one.vehicle_id for one in peers.lost(160.0)]
