"""One vehicle that publishes its state over Zenoh and over plain UDP sockets at 50 Hz and measures the age of the others'.

    python -m tests.bench.programs.peer_vehicle VEHICLE_FILE WINDOWS WINDOW_S PORT PORT...

The first port is its own for UDP, the others are those of the other vehicles. It prints `heard` when it has heard all others
over both, measures from the next line of its input on, prints one line of JSON, and publishes until its input ends.
"""

from __future__ import annotations

import socket
import sys
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from companion.config.vehicle import AgentConfig, load_agent
from companion.link.fleet.zenoh_link import ZenohLink
from companion.types.peers import PeerPacket
from companion.wire.messages import decode_peer, encode_peer
from sitl.links.ports import LOOPBACK
from tests.bench.figures import percentile
from tests.bench.programs.vehicle import Input, NewestStates, TickGrid, example_packet, ignore_refused

READ_BYTES = 65_536
DRIFT = 5e-3  # of the period by vehicle id: within seconds the ticks of two vehicles pass each other


class Ages(msgspec.Struct, frozen=True):
    """Ages in ms of the newest state of each peer, at every tick of one window."""

    p50_ms: float
    p99_ms: float


class PeerAges(msgspec.Struct, frozen=True):
    """One item for each window."""

    zenoh: list[Ages]
    udp: list[Ages]


class PlainUdp:
    """The same bytes as Zenoh's, one datagram to each other vehicle. No identities, no discovery, no repetition."""

    def __init__(self, own_port: int, other_ports: Iterable[int]) -> None:
        self._others = [(LOOPBACK, port) for port in other_ports]
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((LOOPBACK, own_port))
        self._socket.setblocking(False)

    def publish(self, packet: PeerPacket) -> None:
        data = encode_peer(packet)
        for address in self._others:
            with suppress(OSError):  # an ICMP error for an earlier packet: the other one does not listen yet
                self._socket.sendto(data, address)

    def receive(self) -> list[PeerPacket]:
        packets = []
        while True:
            try:
                packets.append(decode_peer(self._socket.recv(READ_BYTES)))
            except BlockingIOError:
                return packets
            except OSError:
                continue

    def close(self) -> None:
        self._socket.close()


class _TwoWayVehicle:
    """Publishes over both and receives from both once a tick."""

    def __init__(self, config: AgentConfig, zenoh: ZenohLink, udp: PlainUdp) -> None:
        self._zenoh, self._udp = zenoh, udp
        self._packet = example_packet(config.vehicle.id)
        self._grid = TickGrid(DRIFT * config.vehicle.id)
        self._others = {member.id for member in config.fleet.vehicles} - {config.vehicle.id}
        self._over_zenoh, self._over_udp = NewestStates(), NewestStates()

    @property
    def has_heard_all(self) -> bool:
        return self._others <= self._over_zenoh.sent_s.keys() & self._over_udp.sent_s.keys()

    def tick(self) -> float:
        """Each packet has its own time of sending. The way that goes first changes from tick to tick."""
        self._grid.wait()
        sequence = self._packet.sender.sequence + 1
        self._packet = replace(self._packet, sender=replace(self._packet.sender, sequence=sequence))
        ways = [self._zenoh.publish_peer, self._udp.publish]
        for publish in ways if sequence % 2 else reversed(ways):
            publish(replace(self._packet, motion=replace(self._packet.motion, sent_s=time.monotonic())))
        now_s = time.monotonic()
        packets, _ = self._zenoh.receive(now_s)
        self._over_zenoh.take(received.packet for received in packets)
        self._over_udp.take(self._udp.receive())
        return now_s

    def measure(self, seconds: float) -> tuple[Ages, Ages]:
        """Over Zenoh and over UDP, in the same ticks."""
        zenoh_s: list[float] = []
        udp_s: list[float] = []
        end_s = time.monotonic() + seconds
        while (now_s := self.tick()) < end_s:
            zenoh_s += self._over_zenoh.ages_s(now_s)
            udp_s += self._over_udp.ages_s(now_s)
        return _ages(zenoh_s), _ages(udp_s)


def _ages(ages_s: list[float]) -> Ages:
    return Ages(1e3 * percentile(ages_s, 0.5), 1e3 * percentile(ages_s, 0.99))


def main() -> None:
    config = load_agent(Path(sys.argv[1]))
    windows, window_s = int(sys.argv[2]), float(sys.argv[3])
    own_port, *other_ports = map(int, sys.argv[4:])
    talk = Input()
    link = ZenohLink(config.vehicle.id, config.fleet, config.zenoh, ignore_refused)
    with closing(link), closing(PlainUdp(own_port, other_ports)) as udp:
        vehicle = _TwoWayVehicle(config, link, udp)
        while not vehicle.has_heard_all:
            vehicle.tick()
        print("heard", flush=True)
        while not talk.begun.is_set():
            vehicle.tick()
        ages = [vehicle.measure(window_s) for _ in range(windows)]
        result = PeerAges([zenoh for zenoh, _ in ages], [udp_ages for _, udp_ages in ages])
        print(msgspec.json.encode(result).decode(), flush=True)
        while not talk.ended.is_set():
            vehicle.tick()


if __name__ == "__main__":
    main()
