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
import hashlib
import hmac
import logging
import secrets
import socket
from collections.abc import Callable, Collection
from functools import partial
from ipaddress import ip_address
from math import inf

import zenoh

from companion.config.fleet import FleetConfig
from companion.config.vehicle import LOOPBACK, DatagramEndpoints
from companion.link.byte_links import LinkError, explain, read_waiting, resolve
from companion.link.fleet.zenoh_session import drain, each, subscriber
from companion.types.notices import Code
from companion.types.peers import PeerPacket, ReceivedPeerPacket
from companion.wire.keys import ANY, pairing_key, pairing_sender_of
from companion.wire.messages import WireError, decode_peer, encode_peer

READ_BYTES = 16_384  # a change of MAX_VEHICLES slots with a tag for each vehicle has 11,000; most packets a few hundred
DATAGRAMS_PER_VEHICLE = 8  # read in one tick
# A stranger may send as much as the network carries. To refuse a forged datagram takes 4 us here, so that in
# a tick more of them are read than arrive at 20,000 a second, and none waits before those of the fleet.
READ_WITH_SEAL = 512
BUFFER_BYTES = 1 << 20
LONGEST_BYTES, BYTES_PER_VEHICLE = 600, 40  # largest peer packet: a fixed part, and slots in a formation change
SAME_NETWORK = 1  # time to live of multicast: no router passes it on
DEAF_AFTER_S = 1.0  # without an own datagram, which comes back at once
JOIN_AGAIN_S = 0.5  # between two tries

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
        """Bind the socket and look up the receivers. With `seal` only authenticated datagrams are used. Raises LinkError."""
        self.seal = seal
        self._fleet_ids = frozenset(member.id for member in fleet.vehicles)
        self._reject = reject
        self._published: bytes | None = None
        self._read_in_a_tick = READ_WITH_SEAL if seal else DATAGRAMS_PER_VEHICLE * len(self._fleet_ids)
        self._receivers = [_resolve(endpoint) for endpoint in endpoints.send_to]
        self._group = next((host for host, _ in self._receivers if ip_address(host).is_multicast), None)
        self._listen = _interface(endpoints.listen, fleet) if self._group else _resolve(endpoints.listen)
        self._name = f"multicast {self._group} on {self._listen[0]}"
        self._socket = _open_socket(self._listen, self._group)
        self._heard_s: float | None = None  # the last time at which no own datagram was missing
        self._joins = 0  # tries since then
        self._is_awaited = self._is_absent = False

    def receive(self, now_s: float) -> tuple[ReceivedPeerPacket, ...]:
        """All peer packets since the last call. Never blocks."""
        packets = []
        for data in read_waiting(partial(self._socket.recv, READ_BYTES), self._read_in_a_tick):
            self._is_awaited = False
            if data == self._published:
                continue  # the own broadcast
            if packet := self._packet(data):
                packets.append(ReceivedPeerPacket(now_s, packet))
        if self._group:
            self._keep_joined(self._group, now_s)
        return tuple(packets)

    def _keep_joined(self, group: str, now_s: float) -> None:
        """The kernel gives every member its own datagrams back. Where it does not, the interface went or was made again."""
        if not self._is_awaited or self._heard_s is None:
            self._heard_s = now_s
            if self._joins:
                _log.warning("%s: joined again, after the network interface was lost", self._name)
            self._joins, self._is_absent = 0, False
        elif now_s - self._heard_s > DEAF_AFTER_S + self._joins * JOIN_AGAIN_S:
            self._joins += 1
            try:
                opened = _open_socket(self._listen, group)
            except LinkError as error:
                if not self._is_absent:
                    _log.warning("%s: nothing is sent or received: %s", self._name, error)
                self._is_absent = True
            else:
                self._socket.close()
                self._socket = opened

    def _packet(self, data: bytes) -> PeerPacket | None:
        if self.seal is None:
            return packet_of_fleet(data, self._fleet_ids, self._reject)
        opened = self.seal.open_packet(data)
        if isinstance(opened, Code):
            self._reject(opened)
            return None
        sender_id, payload = opened
        return packet_of_fleet(payload, self._fleet_ids, self._reject, sender_id)

    def publish_peer(self, packet: PeerPacket) -> None:
        """Send the own peer packet to all receivers."""
        data = encode_peer(packet)
        if self.seal:
            data = self.seal.seal_packet(data)
        self._published, self._is_awaited = data, True
        for address in self._receivers:
            with contextlib.suppress(OSError):  # a full buffer, no route or no listener: a lost packet
                self._socket.sendto(data, address)

    def close(self) -> None:
        """Close the socket."""
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
HEADER_BYTES = 3


class DatagramSeal:
    """Keys of one vehicle for all others, and their keys for it."""

    def __init__(self, own_id: int, fleet_ids: Collection[int]) -> None:
        self._own_id = own_id
        self.own_keys = {i: secrets.token_bytes(KEY_BYTES) for i in sorted(fleet_ids) if i != own_id}
        self._keys: dict[int, bytes] = {}  # by sender

    def learn(self, sender_id: int, key: bytes) -> None:
        """The key with which this sender makes its tags for this vehicle. Another length is no key."""
        if sender_id in self.own_keys and len(key) == KEY_BYTES:
            self._keys[sender_id] = bytes(key)

    def forget(self, vehicle_id: int) -> None:
        """From now on neither receive from this vehicle nor make tags for it."""
        self.own_keys.pop(vehicle_id, None)
        self._keys.pop(vehicle_id, None)

    def seal_packet(self, payload: bytes) -> bytes:
        """The datagram of a peer packet."""
        signed = bytes((self._own_id,)) + payload
        tags = [bytes((i,)) + _tag(key, signed) for i, key in self.own_keys.items()]
        return b"".join((bytes((MARK, self._own_id, len(tags))), *tags, payload))

    def open_packet(self, datagram: bytes) -> tuple[int, bytes] | Code:
        """Sender and peer packet; for anything that this sender did not make for this vehicle the code of the rejection."""
        if len(datagram) < HEADER_BYTES or datagram[0] != MARK:
            return Code.PEER_NOT_AUTHENTICATED
        sender_id, count = datagram[1], datagram[2]
        payload = datagram[HEADER_BYTES + count * (1 + TAG_BYTES) :]
        key = self._keys.get(sender_id)
        tag = self._own_tag(datagram, count)
        if key is None or tag is None or not hmac.compare_digest(tag, _tag(key, bytes((sender_id,)) + payload)):
            return Code.PEER_NOT_AUTHENTICATED
        return sender_id, payload

    def _own_tag(self, datagram: bytes, count: int) -> bytes | None:
        for place in range(HEADER_BYTES, HEADER_BYTES + count * (1 + TAG_BYTES), 1 + TAG_BYTES):
            if len(datagram) >= place + 1 + TAG_BYTES and datagram[place] == self._own_id:
                return datagram[place + 1 : place + 1 + TAG_BYTES]
        return None


def _tag(key: bytes, content: bytes) -> bytes:
    return hashlib.blake2s(content, key=key, digest_size=TAG_BYTES).digest()


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
