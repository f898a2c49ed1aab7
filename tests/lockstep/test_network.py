"""The network between agents: who hears what, when, and what is lost."""

import pytest

from companion.types import ZERO3, FlightPhase, FlownSlot, PeerPacket, Role
from sitl.config import Links
from sitl.network import Network


def packet(vehicle_id: int, sequence: int) -> PeerPacket:
    return PeerPacket(
        vehicle_id,
        1,
        sequence,
        7,
        FlightPhase.FORMATION,
        Role.FOLLOWER,
        ZERO3,
        ZERO3,
        ZERO3,
        0.0,
        0.0,
        2,
        None,
        FlownSlot(ZERO3),
    )


def sequences(network: Network, receiver: int, now_s: float) -> list[int]:
    return [received.packet.sequence for received in network.receive(receiver, now_s)]


def heard(links: Links, seed: int, packets: int = 2000) -> list[tuple[int, ...]]:
    """What vehicles 2 and 3 hear of vehicle 1, tick by tick."""
    network = Network([1, 2, 3], links, seed)
    ticks = []
    for number in range(packets):
        now_s = number * 0.02
        network.send(packet(1, number), now_s)
        ticks += [tuple(sequences(network, receiver, now_s)) for receiver in (2, 3)]
    return ticks


def test_all_others_hear_a_packet_once_after_its_delay() -> None:
    network = Network([1, 2, 3], Links(peer_delay_s=0.1), 1)
    network.send(packet(1, 5), 1.0)
    assert sequences(network, 2, 1.09) == []
    assert sequences(network, 2, 1.11) == [5]
    assert sequences(network, 2, 1.2) == []
    assert sequences(network, 3, 1.2) == [5]
    assert sequences(network, 1, 9.0) == []


def test_agents_that_tick_together_never_hear_each_other_in_the_same_tick() -> None:
    """Not even without a delay: else it would matter who is asked first."""
    network = Network([1, 2], Links(peer_delay_s=0.0), 1)
    network.send(packet(1, 1), 1.0)
    assert sequences(network, 2, 1.0) == []
    assert sequences(network, 2, 1.02) == [1]


def test_the_time_of_looking_is_that_of_receipt() -> None:
    network = Network([1, 2], Links(), 1)
    network.send(packet(1, 1), 1.0)
    (received,) = network.receive(2, 1.019)
    assert received.received_s == 1.019


def test_loss_is_as_large_as_given_and_of_each_way_by_itself() -> None:
    ticks = heard(Links(peer_loss=0.1), seed=1)
    to_2, to_3 = ticks[::2], ticks[1::2]
    for way in (to_2, to_3):
        assert sum(map(len, way)) == pytest.approx(1800, abs=60)
    assert to_2 != to_3


def test_the_same_seed_loses_the_same_packets() -> None:
    links = Links(peer_loss=0.1, peer_delay_s=0.1, peer_jitter_s=0.03)
    assert heard(links, seed=4) == heard(links, seed=4)
    assert heard(links, seed=4) != heard(links, seed=5)


def test_jitter_may_let_one_packet_overtake_another() -> None:
    arrived = [number for tick in heard(Links(peer_jitter_s=0.1), seed=1)[::2] for number in tick]
    assert arrived != sorted(arrived)
    assert len(arrived) > 1990


def test_everything_may_be_lost() -> None:
    assert not any(heard(Links(peer_loss=1.0), seed=1))
