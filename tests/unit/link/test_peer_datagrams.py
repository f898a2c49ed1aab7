"""Peer packets as UDP datagrams, over real sockets of this machine."""

import socket
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager

import pytest
from msgspec.structs import replace

from agent_process import free_port
from companion.config.fleet import EdgeNeighbours, FleetConfig, FormationMember
from companion.config.vehicle import DatagramEndpoints
from companion.link.endpoint import LinkError
from companion.link.peer_datagrams import PeerDatagrams
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.notices import Code
from companion.types.peers import PeerPacket
from companion.types.vectors import ZERO3
from companion.wire.peer import encode_peer

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
    1, 7, 1, 5, FlightPhase.HOLD, Role.LEADER, ZERO3, ZERO3, ZERO3, 0.01, 0.0, 1, None, FlownSlot(ZERO3)
)


@pytest.fixture
def address() -> str:
    return f"127.0.0.1:{free_port(36000, socket.SOCK_DGRAM)}"


def other_address() -> str:
    return f"127.0.0.1:{free_port(31000, socket.SOCK_DGRAM)}"


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


def test_publishing_continues_while_nobody_listens(address: str) -> None:
    with link(other_address(), address) as first:
        for _ in range(3):
            first.publish_peer(PACKET)
            assert first.receive(1.0) == ()


def test_an_own_broadcast_is_not_received(address: str) -> None:
    with link(address, address) as alone:
        alone.publish_peer(PACKET)
        time.sleep(0.02)
        assert alone.receive(1.0) == ()
        alone.publish_peer(replace(PACKET, sequence=2))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as double:  # another vehicle with this id
            host, _, port = address.rpartition(":")
            double.sendto(encode_peer(replace(PACKET, session=8)), (host, int(port)))
        assert [packet.session for packet in received(alone)] == [8]


def test_other_data_is_counted_and_dropped(address: str) -> None:
    rejected = Counter[str]()
    with link(address, "127.0.0.1:9", rejected=rejected) as second, link(other_address(), address) as first:
        first.publish_peer(replace(PACKET, vehicle_id=9))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            host, _, port = address.rpartition(":")
            for data in (b"", b"x" * 9000, encode_peer(PACKET)[:-7]):
                stranger.sendto(data, (host, int(port)))
        first.publish_peer(PACKET)
        time.sleep(0.05)
        assert received(second) == [PACKET]
    assert rejected[Code.PEER_NOT_IN_FLEET] == 1
    assert sum(rejected.values()) == 4


def test_a_flood_does_not_hold_the_tick(address: str) -> None:
    with link(address, "127.0.0.1:9") as second, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        host, _, port = address.rpartition(":")
        for sequence in range(100):
            stranger.sendto(encode_peer(replace(PACKET, sequence=sequence)), (host, int(port)))
        assert len(received(second)) == 16


@pytest.mark.parametrize("listen", ["192.0.2.1:7447", "no such host:7447", "127.0.0.1:70000", "a..b:1"])
def test_an_address_that_cannot_be_used_is_refused(listen: str) -> None:
    with pytest.raises(LinkError):
        PeerDatagrams(DatagramEndpoints(listen, ("127.0.0.1:9",)), FLEET, lambda _code: None)


def test_a_port_in_use_is_refused(address: str) -> None:
    with link(address, "127.0.0.1:9"), pytest.raises(LinkError, match="is in use"):
        PeerDatagrams(DatagramEndpoints(address, ("127.0.0.1:9",)), FLEET, lambda _code: None)
