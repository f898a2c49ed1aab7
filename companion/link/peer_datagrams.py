"""Peer packets as UDP datagrams, for radio links that lose packets.

In a TCP stream every later state waits until a lost one was sent again, which takes longer than a state is of use. A lost
datagram costs only itself.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Collection

from companion.config.fleet import FleetConfig
from companion.config.vehicle import DatagramEndpoints
from companion.link.endpoint import LinkError, check_host, explain
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.wire.peer import decode_peer, encode_peer
from companion.wire.version import WireError

READ_BYTES = 4096  # a peer packet has a few hundred
DATAGRAMS_PER_VEHICLE = 8  # read in one tick

Address = tuple[str, int]


class PeerDatagrams:
    """One UDP socket. Calls `reject` with the counter's key for every refused datagram."""

    def __init__(self, endpoints: DatagramEndpoints, fleet: FleetConfig, reject: Callable[[str], None]) -> None:
        """Bind the socket and look up the receivers. Raises LinkError."""
        self._fleet_ids = frozenset(member.id for member in fleet.vehicles)
        self._reject = reject
        self._published: bytes | None = None
        self._receivers = [_resolved(endpoint) for endpoint in endpoints.send_to]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind(_resolved(endpoints.listen))
        except OSError as error:
            self._socket.close()
            raise LinkError(explain(error, f"UDP port {endpoints.listen.rpartition(':')[2]}")) from error
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        self._socket.setblocking(False)

    def receive(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """All peer packets since the last call. Never blocks."""
        packets = []
        for _ in range(DATAGRAMS_PER_VEHICLE * len(self._fleet_ids)):
            try:
                data = self._socket.recv(READ_BYTES)
            except BlockingIOError:
                break
            except OSError:
                continue  # ICMP error for a datagram sent earlier
            if data == self._published:
                continue  # the own broadcast
            if packet := packet_of_fleet(data, self._fleet_ids, self._reject):
                packets.append(ReceivedPeerPacket(now_s, packet))
        return tuple(packets)

    def publish_peer(self, packet: PeerPacket) -> None:
        """Send the own peer packet to all receivers."""
        self._published = data = encode_peer(packet)
        for address in self._receivers:
            with contextlib.suppress(OSError):  # a full buffer, no route or no listener: a lost packet
                self._socket.sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def packet_of_fleet(data: bytes, fleet_ids: Collection[int], reject: Callable[[str], None]) -> PeerPacket | None:
    """The decoded peer packet of a vehicle of this fleet; None for any other data, which is counted."""
    try:
        packet = decode_peer(data)
    except WireError as error:
        reject(error.key)
        return None
    if packet.vehicle_id not in fleet_ids:  # counted without the id: unknown senders cannot fill the counters
        reject(Code.PEER_NOT_IN_FLEET)
        return None
    return packet


def _resolved(endpoint: str) -> Address:
    host, _, port = endpoint.rpartition(":")
    check_host(host)
    if not 0 < int(port) <= 65535:
        raise LinkError(f"port {port} does not exist, expected 1 to 65535")
    try:
        address = socket.getaddrinfo(host, int(port), socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except socket.gaierror as error:
        raise LinkError(f'"{host}" has no address; expected one like 192.168.1.11') from error
    return str(address[0]), int(address[1])
