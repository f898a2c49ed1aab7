"""Peer packets as UDP datagrams, for radio links that lose packets, and their authentication.

In a TCP stream every later state waits until a lost one was sent again, which takes longer than a state is of use. A lost
datagram costs only itself.

Authentication is one tag for each receiver, with a key that only the sender and this receiver know. A key for the whole fleet
would let every vehicle speak for every other one. The keys are random, new with each start of the sender, and reach each
receiver over its own authenticated Zenoh link (`Pairing`).

A datagram: MARK, sender id, number of tags, the tags (receiver id, 8 bytes), then the peer packet. A tag is the keyed
BLAKE2s (RFC 7693) of sender id and peer packet, 8 bytes long: a quarter of the time of an HMAC-SHA256.
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import hmac
import logging
import secrets
import socket
from collections.abc import Callable, Collection
from functools import partial
from ipaddress import ip_address
from math import inf
from typing import Any

import zenoh

from companion.config.fleet import FleetConfig
from companion.config.vehicle import LOOPBACK, DatagramEndpoints
from companion.link.byte_links import LinkError, explain, read_waiting, resolve
from companion.link.fleet.zenoh_session import drain, each, subscriber
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.wire.keys import ANY, pairing_key, pairing_sender_of
from companion.wire.messages import WireError, decode_peer, encode_peer

DATAGRAMS_PER_VEHICLE = 8  # read in one tick
LATE_PER_VEHICLE = 2  # likewise where a setpoint waits; the rest of a flood waits for the next tick
# A stranger may send as much as the network carries. To refuse a forged datagram takes 4 us here, so that in
# a tick more of them are read than arrive at 20,000 a second, and none waits before those of the fleet.
READ_WITH_SEAL = 512
BUFFER_BYTES = 1 << 20
LONGEST_BYTES, BYTES_PER_VEHICLE = 1200, 40  # largest peer packet: a fixed part, and slots in a formation change
# Linux; missing in the socket module. Where it is off, nothing is received from an interface on which only another program of
# this computer has joined the group: a fleet on loopback hears nobody in the network.
IP_MULTICAST_ALL = 49
SAME_NETWORK = 1  # time to live of multicast: no router passes it on
DEAF_AFTER_S = 1.0  # without an own datagram, which comes back at once
JOIN_AGAIN_S = 0.5  # between two tries
NOT_THERE = (errno.ENODEV, errno.EADDRNOTAVAIL)  # no network interface has this address, yet or any more

Address = tuple[str, int]

_log = logging.getLogger(__name__)


class PeerDatagrams:
    """One UDP socket. Calls `reject` with the counter's key for every refused datagram."""

    def __init__(
        self,
        endpoints: DatagramEndpoints,
        fleet: FleetConfig,
        reject: Callable[[str], None],
        seal: DatagramSeal | None = None,
    ) -> None:
        """Bind the socket and look up the receivers. With `seal` only authenticated datagrams are used. Raises LinkError.

        A multicast group is joined later where its network interface is not there yet: an agent starts before its network.
        """
        self.seal = seal
        self._fleet_ids = frozenset(member.id for member in fleet.vehicles)
        self._reject = reject
        self._published: bytes | None = None
        vehicles = len(self._fleet_ids)
        self._most, self._most_late = DATAGRAMS_PER_VEHICLE * vehicles, LATE_PER_VEHICLE * vehicles
        self._read_bytes = LONGEST_BYTES + BYTES_PER_VEHICLE * vehicles + 1  # of a longer datagram enough to refuse it
        if seal:
            self._most = READ_WITH_SEAL
            self._read_bytes += HEADER_BYTES + vehicles * TAG_SPAN_BYTES
        self._receivers = [_resolve(endpoint) for endpoint in endpoints.send_to]
        self._group = next((host for host, _ in self._receivers if ip_address(host).is_multicast), None)
        self._listen = _interface(endpoints.listen, fleet) if self._group else _resolve(endpoints.listen)
        self._name = f"multicast {self._group} on {self._listen[0]}"
        self._socket: socket.socket | None = None
        self._heard_s: float | None = None  # the last time at which no own datagram was missing
        self._joins = 0  # tries since then
        self._is_awaited = self._is_absent = False
        try:
            self._socket = _open_socket(self._listen, self._group)
        except LinkError as error:
            if not self._group or getattr(error.__cause__, "errno", None) not in NOT_THERE:
                raise
            self._miss(error)

    def receive(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """All peer packets since the last call. Never blocks."""
        packets = self._read(now_s, self._most)
        if self._group:
            self._keep_joined(self._group, now_s)
        return packets

    def receive_late(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """A few of the packets that the next `receive` would return. Never blocks."""
        return self._read(now_s, self._most_late)

    def _read(self, now_s: float, most: int) -> tuple[ReceivedPeerPacket, ...]:
        """The packets of at most so many datagrams."""
        if self._socket is None:
            return ()
        packets, fleet_ids, reject, seal = [], self._fleet_ids, self._reject, self.seal
        for data in read_waiting(partial(self._socket.recv, self._read_bytes), most):
            self._is_awaited = False
            if data == self._published:
                continue  # the own broadcast
            sender_id: int | None = None
            if seal is not None:
                opened = seal.open_packet(data)
                if opened is None:
                    reject(Code.PEER_NOT_AUTHENTICATED)
                    continue
                sender_id, data = opened
            packet = packet_of_fleet(data, fleet_ids, reject, sender_id)
            if packet is not None:
                packets.append(ReceivedPeerPacket(now_s, packet))
        return tuple(packets)

    def _keep_joined(self, group: str, now_s: float) -> None:
        """The kernel gives every member its own datagrams back. Where it does not, the interface went or was made again."""
        if self._heard_s is None:
            self._heard_s = now_s
        if self._socket is not None and not self._is_awaited:
            self._heard_s = now_s
            if self._joins:
                _log.warning("%s: joined again, after the network interface was lost", self._name)
            self._joins, self._is_absent = 0, False
        elif now_s - self._heard_s > DEAF_AFTER_S + self._joins * JOIN_AGAIN_S:
            self._joins += 1
            try:
                opened = _open_socket(self._listen, group)
            except LinkError as error:
                self._miss(error)
            else:
                self.close()
                self._socket = opened

    def _miss(self, error: LinkError) -> None:
        """Say once that the network interface is not there."""
        if not self._is_absent:
            _log.warning("%s: nothing is sent or received: %s", self._name, error)
        self._is_absent = True

    def publish_peer(self, packet: PeerPacket) -> None:
        """Send the own peer packet to all receivers."""
        data = encode_peer(packet)
        if self.seal:
            data = self.seal.seal_packet(data)
        self._published, self._is_awaited = data, True
        if self._socket is None:
            return
        for address in self._receivers:
            with contextlib.suppress(OSError):  # a full buffer, no route or no listener: a lost packet
                self._socket.sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()


def packet_of_fleet(
    data: bytes, fleet_ids: Collection[int], reject: Callable[[str], None], sender_id: int | None = None
) -> PeerPacket | None:
    """The decoded peer packet of a vehicle of this fleet; None for any other data, which is counted.

    `sender_id`: the vehicle that it comes from, as far as that is known otherwise.

    To decode takes 5 ns a byte, so what is longer than any packet of this fleet is refused before.
    """
    if len(data) > LONGEST_BYTES + BYTES_PER_VEHICLE * len(fleet_ids):
        reject(Code.PEER_MALFORMED)
        return None
    try:
        packet = decode_peer(data)
    except WireError as error:
        reject(error.key)
        return None
    except Exception as error:  # noqa: BLE001 -- a defect in the decoder costs the packet and not the vehicle
        _log.error("a peer packet is not used: %s: %.200s", type(error).__name__, error)
        reject(Code.PEER_MALFORMED)
        return None
    if packet.sender.vehicle_id not in fleet_ids:  # counted without the id: unknown senders cannot fill the counters
        reject(Code.PEER_NOT_IN_FLEET)
        return None
    if sender_id is not None and packet.sender.vehicle_id != sender_id:
        reject(Code.PEER_KEY_MISMATCH)
        return None
    return packet


def _open_socket(address: Address, group: str | None) -> socket.socket:
    """A bound socket, of a multicast group where there is one. Raises LinkError."""
    opened = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        opened.setblocking(False)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        if group:  # vehicles on one machine share its port
            opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, SAME_NETWORK)
            own = socket.inet_aton(address[0])  # address of the network interface; 0.0.0.0: chosen by the routes
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + own)
            opened.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
            with contextlib.suppress(OSError):  # not Linux
                opened.setsockopt(socket.IPPROTO_IP, IP_MULTICAST_ALL, 0)
        opened.bind((group or address[0], address[1]))  # to the group: nothing else that comes to this port
    except OSError as error:
        opened.close()
        raise LinkError(explain(error, f"UDP port {address[1]}")) from error
    return opened


def _interface(endpoint: str, fleet: FleetConfig) -> Address:
    """Address of the network interface of a multicast group, and its port. Raises LinkError.

    Debian gives the own name of a computer the address 127.0.1.1. Then it is the interface that leads to the other vehicles.
    """
    host, port = _resolve(endpoint)
    name = endpoint.rpartition(":")[0]
    if LOOPBACK.fullmatch(name) or not ip_address(host).is_loopback:
        return host, port
    for member in fleet.vehicles:
        if member.address is not None and (towards := _source_towards(member.address)):
            return towards, port
    raise LinkError(
        f'"{name}" is {host} on this computer (/etc/hosts), and no other vehicle is reached over a network; expected the'
        " address of its network interface, like 192.168.1.11"
    )


def _source_towards(endpoint: str) -> str | None:
    """The own address from which packets to this one leave; None where it has no route, or is on this computer."""
    with contextlib.suppress(LinkError, OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(_resolve(endpoint))  # sends nothing
        source = str(probe.getsockname()[0])
        return None if ip_address(source).is_loopback else source
    return None


def _resolve(endpoint: str) -> Address:
    host, _, port = endpoint.rpartition(":")
    hint = f'"{host}" has no address; expected one like 192.168.1.11'
    *_, address = resolve(host, int(port), hint, socket.AF_INET)
    return str(address[0]), int(address[1])


MARK = 0xD5  # no wire version, so that a fleet with and without authentication is told apart
KEY_BYTES, TAG_BYTES = 32, 8
HEADER_BYTES, TAG_SPAN_BYTES = 3, 1 + TAG_BYTES


class DatagramSeal:
    """Keys of one vehicle for all others, and their keys for it."""

    def __init__(self, own_id: int, fleet_ids: Collection[int]) -> None:
        self._own_id = own_id
        self.own_keys = {i: secrets.token_bytes(KEY_BYTES) for i in sorted(fleet_ids) if i != own_id}
        self._begun: dict[int, Any] = {}  # by sender, the hash with its key and id

    def learn(self, sender_id: int, key: bytes) -> None:
        """The key with which this sender makes its tags for this vehicle. Another length is no key."""
        if sender_id in self.own_keys and len(key) == KEY_BYTES:
            self._begun[sender_id] = _begun_tag(key, sender_id)

    def forget(self, vehicle_id: int) -> None:
        """From now on neither receive from this vehicle nor make tags for it."""
        self.own_keys.pop(vehicle_id, None)
        self._begun.pop(vehicle_id, None)

    def seal_packet(self, payload: bytes) -> bytes:
        """The datagram of a peer packet."""
        parts = [bytes((MARK, self._own_id, len(self.own_keys)))]
        for receiver_id, key in self.own_keys.items():
            tag = _begun_tag(key, self._own_id)
            tag.update(payload)
            parts += (bytes((receiver_id,)), tag.digest())
        return b"".join((*parts, payload))

    def open_packet(self, datagram: bytes) -> tuple[int, bytes] | None:
        """Sender and peer packet; None for anything that this sender did not make for this vehicle."""
        if len(datagram) < HEADER_BYTES or datagram[0] != MARK:
            return None
        sender_id, end = datagram[1], HEADER_BYTES + datagram[2] * TAG_SPAN_BYTES
        begun = self._begun.get(sender_id)
        place = datagram[HEADER_BYTES:end:TAG_SPAN_BYTES].find(self._own_id)  # among the ids of the receivers
        if begun is None or place < 0 or len(datagram) < end:
            return None
        at, payload, tag = HEADER_BYTES + place * TAG_SPAN_BYTES + 1, datagram[end:], begun.copy()
        tag.update(payload)
        return (sender_id, payload) if hmac.compare_digest(datagram[at : at + TAG_BYTES], tag.digest()) else None


def _begun_tag(key: bytes, sender_id: int) -> Any:
    """The hash of a tag, before the peer packet."""
    return hashlib.blake2s(bytes((sender_id,)), key=key, digest_size=TAG_BYTES)


PERIOD_S = 1.0  # a vehicle that restarts has all keys after this time
KEYS_READ = 16  # in one tick


class Pairing:
    """Publishes and receives once per period; a step costs a few microseconds otherwise."""

    def __init__(self, session: zenoh.Session, fleet: str, own_id: int, seal: DatagramSeal) -> None:
        self._session, self._fleet, self._own_id, self._seal = session, fleet, own_id, seal
        self._keys = subscriber(session, pairing_key(fleet, ANY, own_id), 2 * len(seal.own_keys) or 1)
        self._due_s = -inf

    def step(self, now_s: float) -> None:
        """Never blocks."""
        each(drain(self._keys, KEYS_READ), self._learn, lambda: None)
        if now_s < self._due_s:
            return
        self._due_s = now_s + PERIOD_S
        for receiver_id, key in self._seal.own_keys.items():
            to = pairing_key(self._fleet, self._own_id, receiver_id)
            self._session.put(to, key, congestion_control=zenoh.CongestionControl.DROP)

    def _learn(self, sample: zenoh.Sample) -> None:
        sender_id = pairing_sender_of(str(sample.key_expr))
        if sender_id is not None:
            self._seal.learn(sender_id, sample.payload.to_bytes())
