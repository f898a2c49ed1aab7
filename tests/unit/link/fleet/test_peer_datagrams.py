"""Peer packets as UDP datagrams, over real sockets of this machine."""

import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import with_fields
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.vehicle import DatagramEndpoints
from companion.link.byte_links import LinkError
from companion.link.fleet.peer_datagrams import (
    BYTES_PER_VEHICLE,
    HEADER_BYTES,
    LONGEST_BYTES,
    MARK,
    DatagramSeal,
    PeerDatagrams,
    packet_of_fleet,
)
from companion.types.autopilot import PositionError
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange, Heading, HeldReference, LeaderBeacon
from companion.types.notices import Code
from companion.types.peers import MOST_LOST, LeaderReport, LostVehicle, Motion, PeerPacket, Sender, TermProof
from companion.types.values import MAX_NUMBER, MAX_VEHICLES, ZERO3
from companion.wire.messages import encode_peer
from processes import free_port

FLEET = FleetConfig(
    name="pair",
    origin="indoor",
    vehicles=(
        FormationMember(id=1, role=Role.LEADER, slot_enu_m=(0.0, 0.0, 0.0)),
        FormationMember(id=2, role=Role.FOLLOWER, slot_enu_m=(-1.5, 0.0, 0.0)),
    ),
    neighbours=EdgeNeighbours(edges=((1, 2),)),
)
PACKET = PeerPacket(
    sender=Sender(1, 7, 1, 5),
    phase=FlightPhase.HOLD,
    role=Role.LEADER,
    motion=Motion(ZERO3, ZERO3, ZERO3, state_age_s=0.01, sent_s=0.0),
    leader=LeaderReport(1, None),
    slot=FlownSlot(ZERO3),
)


@pytest.fixture
def address() -> str:
    return f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"


def other_address() -> str:
    return f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"


@contextmanager
def link(listen: str, *send_to: str, rejected: Counter[str] | None = None) -> Iterator[PeerDatagrams]:
    reject = (rejected if rejected is not None else Counter[str]()).update
    with closing(PeerDatagrams(DatagramEndpoints(listen, send_to), FLEET, lambda code: reject([code]))) as opened:
        yield opened


def received(datagrams: PeerDatagrams) -> list[PeerPacket]:
    end_s = time.monotonic() + 1.0
    while not (packets := datagrams.receive(3.0)) and time.monotonic() < end_s:
        time.sleep(0.005)
    assert {packet.received_s for packet in packets} <= {3.0}
    return [packet.packet for packet in packets]


def test_a_peer_packet_arrives_in_the_other_agent(address: str) -> None:
    with link(address, "127.0.0.1:9") as second, link(other_address(), address) as first:
        first.publish_peer(PACKET)
        assert received(second) == [PACKET]
        assert second.receive(4.0) == ()


def test_a_change_of_the_largest_fleet_arrives_with_a_tag_for_each_vehicle(address: str) -> None:
    ids = range(1, MAX_VEHICLES + 1)
    sending, receiving = DatagramSeal(1, ids), DatagramSeal(2, ids)
    receiving.learn(1, sending.own_keys[2])
    change = FormationChange(1, tuple((i, (0.1 * i, 0.2, 0.3)) for i in ids), 1.5, 2.5, tuple(ids))
    packet = replace(PACKET, change=change)
    ends = DatagramEndpoints(other_address(), (address,)), DatagramEndpoints(address, ("127.0.0.1:9",))
    largest = replace(FLEET, vehicles=tuple(replace(FLEET.vehicles[0], id=i) for i in ids))
    with (
        closing(PeerDatagrams(ends[0], largest, pytest.fail, sending)) as first,
        closing(PeerDatagrams(ends[1], largest, pytest.fail, receiving)) as second,
    ):
        first.publish_peer(packet)
        assert received(second) == [packet]


def test_publishing_continues_while_nobody_listens(address: str) -> None:
    with link(other_address(), address) as first:
        for _ in range(3):
            first.publish_peer(PACKET)
            assert first.receive(1.0) == ()


def test_a_group_that_gives_the_own_datagrams_back_is_not_joined_again(caplog: pytest.LogCaptureFixture) -> None:
    group = f"239.255.77.9:{free_port(socket.SOCK_DGRAM)}"
    with link(f"127.0.0.1:{group.rpartition(':')[2]}", group) as alone:
        for number in range(8):
            alone.publish_peer(with_fields(PACKET, sequence=number))
            time.sleep(0.02)
            assert alone.receive(5.0 * number) == ()
        for number in range(8):
            assert alone.receive(40.0 + number) == ()  # nothing is published
    assert not caplog.records


def test_an_agent_starts_before_its_network(caplog: pytest.LogCaptureFixture) -> None:
    """192.0.2.1 is no address of any computer (RFC 5737)."""
    group = f"239.255.77.9:{free_port(socket.SOCK_DGRAM)}"
    with link(f"192.0.2.1:{group.rpartition(':')[2]}", group) as absent:
        for second in range(20):
            absent.publish_peer(with_fields(PACKET, sequence=second))
            assert absent.receive(1.0 * second) == absent.receive_late(1.0 * second) == ()
    (record,) = caplog.records
    assert "192.0.2.1: nothing is sent or received: this machine has no network interface" in record.getMessage()


def test_a_group_on_loopback_hears_nothing_from_the_network() -> None:
    """Another program of this computer has joined the same group on a network interface."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(("192.0.2.1", 9))  # sends nothing
        except OSError:
            pytest.skip("no network interface beside loopback")
        own = socket.inet_aton(probe.getsockname()[0])
    group, port = "239.255.77.9", free_port(socket.SOCK_DGRAM)
    with (
        link(f"127.0.0.1:{port}", f"{group}:{port}") as on_loopback,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other,
    ):
        other.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + own)
        other.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        other.sendto(encode_peer(PACKET), (group, port))
        time.sleep(0.05)
        assert received(on_loopback) == []


def test_another_error_of_a_group_is_refused() -> None:
    group = f"239.255.77.9:{free_port(socket.SOCK_DGRAM)}"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:  # that does not share its port
        other.bind(("239.255.77.9", int(group.rpartition(":")[2])))
        with pytest.raises(LinkError, match="is in use"):
            PeerDatagrams(DatagramEndpoints(f"127.0.0.1:{group.rpartition(':')[2]}", (group,)), FLEET, pytest.fail)


def test_an_own_broadcast_is_not_received(address: str) -> None:
    with link(address, address) as alone:
        alone.publish_peer(PACKET)
        time.sleep(0.02)
        assert alone.receive(1.0) == ()
        alone.publish_peer(with_fields(PACKET, sequence=2))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as double:  # another vehicle with this id
            host, _, port = address.rpartition(":")
            double.sendto(encode_peer(with_fields(PACKET, session=8)), (host, int(port)))
        assert [packet.sender.session for packet in received(alone)] == [8]


def test_other_data_is_counted_and_dropped(address: str) -> None:
    rejected = Counter[str]()
    with link(address, "127.0.0.1:9", rejected=rejected) as second, link(other_address(), address) as first:
        first.publish_peer(with_fields(PACKET, vehicle_id=9))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            host, _, port = address.rpartition(":")
            for data in (b"", b"x" * 9000, encode_peer(PACKET)[:-7]):
                stranger.sendto(data, (host, int(port)))
        first.publish_peer(PACKET)
        time.sleep(0.05)
        assert received(second) == [PACKET]
    assert rejected[Code.PEER_NOT_IN_FLEET] == 1
    assert sum(rejected.values()) == 4


def longest_packet(vehicles: int) -> PeerPacket:
    """Every field as long as it may be: numbers of nine bytes, ids of two."""
    number, motion = MAX_NUMBER, ((-1e3 / 3, 1e3 / 3, 1e2 / 3),) * 3
    ids = range(MAX_VEHICLES, MAX_VEHICLES - vehicles, -1)
    return PeerPacket(
        sender=Sender(MAX_VEHICLES, number, number, 2**64 - 1),
        phase=FlightPhase.FORMATION,
        role=Role.FOLLOWER,
        motion=Motion(*motion, state_age_s=1.0 / 3, sent_s=1e6 / 3),
        leader=LeaderReport(
            MAX_VEHICLES,
            LeaderBeacon(MAX_VEHICLES, number, number, 1.0 / 3, number, Heading(1.0 / 3, 1.0 / 3, 1.0 / 3)),
            TermProof(number, bytes(64)),
        ),
        slot=FlownSlot(*motion, number, number, 1.0 / 3),
        position_error=PositionError(1.0 / 3, 1.0 / 3),
        reference=HeldReference(number, number, 1.0 / 3),
        change=FormationChange(number, tuple((i, motion[0]) for i in ids), 1.0 / 3, 1.0 / 3, tuple(ids)),
        armed=True,
        rft=motion,
        home_enu_m=(1e3 / 3, 1e3 / 3),
        lost=tuple(LostVehicle(MAX_VEHICLES, motion[0], motion[0], 1e3 / 3) for _ in range(MOST_LOST)),
    )


@pytest.mark.parametrize("vehicles", [1, 2, 16, MAX_VEHICLES])
def test_what_is_longer_than_any_packet_of_the_fleet_is_not_even_decoded(vehicles: int) -> None:
    packet, rejected = longest_packet(vehicles), Counter[str]()
    ids, data = range(MAX_VEHICLES, MAX_VEHICLES - vehicles, -1), encode_peer(packet)
    assert packet_of_fleet(data, ids, pytest.fail) == packet
    longer = data + bytes(LONGEST_BYTES + BYTES_PER_VEHICLE * vehicles - len(data) + 1)
    assert packet_of_fleet(longer, ids, lambda key: rejected.update([key])) is None
    assert rejected == {Code.PEER_MALFORMED: 1}


def test_a_flood_does_not_hold_the_tick(address: str) -> None:
    with link(address, "127.0.0.1:9") as second, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        host, _, port = address.rpartition(":")
        for sequence in range(100):
            stranger.sendto(encode_peer(with_fields(PACKET, sequence=sequence)), (host, int(port)))
        assert len(received(second)) == 16


def test_few_are_read_while_a_setpoint_waits(address: str) -> None:
    with link(address, "127.0.0.1:9") as second, link(other_address(), address) as first:
        for sequence in range(10):
            first.publish_peer(with_fields(PACKET, sequence=sequence))
        time.sleep(0.05)
        assert [one.packet.sender.sequence for one in second.receive_late(1.0)] == [0, 1, 2, 3]
        assert [one.packet.sender.sequence for one in second.receive(2.0)] == [4, 5, 6, 7, 8, 9]


@pytest.mark.parametrize("listen", ["192.0.2.1:7447", "no such host:7447", "127.0.0.1:70000", "a..b:1"])
def test_an_address_that_cannot_be_used_is_refused(listen: str) -> None:
    with pytest.raises(LinkError):
        PeerDatagrams(DatagramEndpoints(listen, ("127.0.0.1:9",)), FLEET, lambda _code: None)


def test_a_port_in_use_is_refused(address: str) -> None:
    with link(address, "127.0.0.1:9"), pytest.raises(LinkError, match="is in use"):
        PeerDatagrams(DatagramEndpoints(address, ("127.0.0.1:9",)), FLEET, lambda _code: None)


# ---------------------------------------------------------------- authenticated


def seals() -> tuple[DatagramSeal, DatagramSeal, DatagramSeal]:
    """Of vehicles 1, 2 and 3, after they have exchanged their keys."""
    made = [DatagramSeal(i, (1, 2, 3)) for i in (1, 2, 3)]
    for sender_id, sender in enumerate(made, start=1):
        for receiver_id, key in sender.own_keys.items():
            made[receiver_id - 1].learn(sender_id, key)
    return made[0], made[1], made[2]


def test_a_sealed_packet_is_opened_by_every_receiver() -> None:
    first, second, third = seals()
    datagram = first.seal_packet(b"packet")
    assert second.open_packet(datagram) == third.open_packet(datagram) == (1, b"packet")


def test_a_receiver_cannot_speak_for_the_sender() -> None:
    """Vehicle 2 knows its own key with vehicle 1, not that of vehicle 3 with vehicle 1."""
    first, second, third = seals()
    forged = DatagramSeal(1, (1, 2, 3))
    forged.own_keys.update(dict.fromkeys((2, 3), first.own_keys[2]))
    assert second.open_packet(forged.seal_packet(b"packet")) == (1, b"packet")
    assert third.open_packet(forged.seal_packet(b"packet")) is None


def test_a_sender_cannot_speak_for_another_one() -> None:
    _, second, third = seals()
    datagram = bytearray(second.seal_packet(b"packet"))
    datagram[1] = 1
    assert third.open_packet(bytes(datagram)) is None


@given(place=st.integers(0, 200), change=st.integers(1, 255))
def test_every_changed_byte_that_counts_is_noticed(place: int, change: int) -> None:
    first, second, _ = seals()
    datagram = bytearray(first.seal_packet(b"packet of some length"))
    place %= len(datagram)
    datagram[place] ^= change
    tag_of_third = range(HEADER_BYTES + 9, HEADER_BYTES + 18)
    opened = second.open_packet(bytes(datagram))
    assert opened is None or (place in tag_of_third and opened == (1, b"packet of some length"))


@given(st.binary(max_size=300))
def test_whatever_arrives_is_opened_or_refused(data: bytes) -> None:
    _, second, _ = seals()
    assert second.open_packet(data) is None
    assert second.open_packet(bytes((MARK,)) + data) is None


def test_keys_of_strangers_and_of_wrong_length_are_not_learned() -> None:
    seal = DatagramSeal(1, (1, 2))
    for sender_id, key in ((9, b"k" * 32), (2, b"k"), (1, b"k" * 32)):
        seal.learn(sender_id, key)
    other = DatagramSeal(2, (1, 2))
    assert seal.open_packet(other.seal_packet(b"packet")) is None
    seal.learn(2, other.own_keys[1])
    assert seal.open_packet(other.seal_packet(b"packet")) == (2, b"packet")
    seal.forget(2)
    assert seal.open_packet(other.seal_packet(b"packet")) is None


def test_packets_without_a_tag_are_counted_and_displace_none() -> None:
    rejected: Counter[str] = Counter()
    first, second, _ = seals()
    here, there = other_address(), f"127.0.0.1:{free_port(socket.SOCK_DGRAM)}"
    with (
        closing(
            PeerDatagrams(DatagramEndpoints(here, (there,)), FLEET, lambda code: rejected.update([code]), second)
        ) as to,
        closing(PeerDatagrams(DatagramEndpoints(there, (here,)), FLEET, lambda _: None, first)) as sender,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger,
    ):
        host, port = here.split(":")
        for _ in range(200):
            stranger.sendto(encode_peer(PACKET), (host, int(port)))
        sender.publish_peer(PACKET)
        assert received(to) == [PACKET]
        assert rejected == {Code.PEER_NOT_AUTHENTICATED: 200}


def test_one_multicast_datagram_reaches_every_vehicle_of_the_group() -> None:
    port = free_port(socket.SOCK_DGRAM)
    group = f"239.255.77.1:{port}"
    endpoints = DatagramEndpoints(f"127.0.0.1:{port}", (group,))
    with ExitStack() as stack:
        first, second, third = (
            stack.enter_context(closing(PeerDatagrams(endpoints, FLEET, lambda _: None))) for _ in range(3)
        )
        first.publish_peer(PACKET)
        assert received(second) == received(third) == [PACKET]
        assert first.receive(3.0) == ()  # its own
