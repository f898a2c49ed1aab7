"""One vehicle that publishes its state over Zenoh and over plain UDP sockets at 50 Hz and measures the age of the others'.

    python -m tests.bench.programs.peer_vehicle VEHICLE_FILE WINDOWS WINDOW_S PORT PORT...

The first port is its own for UDP, the others are those of the other vehicles. It prints `heard` when it has heard all others
over both, measures from the next line of its input on, prints one line of JSON, and publishes until its input ends.
"""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Iterable
from contextlib import closing, suppress
from pathlib import Path

import msgspec
from msgspec.structs import replace

from companion.config.vehicle import AgentConfig, load_agent
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.tick import PERIOD_S
from companion.types.peers import PeerPacket
from companion.wire.peer import decode_peer, encode_peer
from sitl.links.ports import LOOPBACK
from tests.bench.figures import percentile
from tests.bench.programs.transport_vehicle import example_packet

READ_BYTES = 65_536
DRIFT = 5e-3  # of the period by vehicle id: within seconds the ticks of two vehicles pass each other


class Ages(msgspec.Struct, frozen=True):
    """Ages in ms of the newest state of each peer, at every tick of one window."""

    p50_ms: float
    p99_ms: float


class Result(msgspec.Struct, frozen=True):
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


class _Vehicle:
    """Publishes over both and receives from both once a tick, on a fixed grid of time."""

    def __init__(self, config: AgentConfig, zenoh: ZenohLink, udp: PlainUdp) -> None:
        self._zenoh, self._udp = zenoh, udp
        self._packet = example_packet(config)
        self._period_s = PERIOD_S * (1.0 + DRIFT * config.vehicle.id)
        self._due_s = time.monotonic()
        self.over_zenoh: dict[int, float] = {}  # time of sending by sender: one machine has one clock
        self.over_udp: dict[int, float] = {}

    def tick(self) -> float:
        """Each packet has its own time of sending. The way that goes first changes from tick to tick."""
        self._due_s += self._period_s
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        self._packet = replace(self._packet, sequence=self._packet.sequence + 1)
        ways = [self._zenoh.publish_peer, self._udp.publish]
        for publish in ways if self._packet.sequence % 2 else reversed(ways):
            publish(replace(self._packet, sent_s=time.monotonic()))
        now_s = time.monotonic()
        packets, _ = self._zenoh.receive(now_s)
        _keep_newest(self.over_zenoh, (received.packet for received in packets))
        _keep_newest(self.over_udp, self._udp.receive())
        return now_s

    def measure(self, seconds: float) -> tuple[Ages, Ages]:
        """Over Zenoh and over UDP, in the same ticks."""
        zenoh_s: list[float] = []
        udp_s: list[float] = []
        end_s = time.monotonic() + seconds
        while (now_s := self.tick()) < end_s:
            zenoh_s += [now_s - sent_s for sent_s in self.over_zenoh.values()]
            udp_s += [now_s - sent_s for sent_s in self.over_udp.values()]
        return _ages(zenoh_s), _ages(udp_s)


def _keep_newest(newest_s: dict[int, float], packets: Iterable[PeerPacket | None]) -> None:
    for packet in packets:
        if packet:
            newest_s[packet.vehicle_id] = max(packet.sent_s, newest_s.get(packet.vehicle_id, packet.sent_s))


def _ages(ages_s: list[float]) -> Ages:
    return Ages(1e3 * percentile(ages_s, 0.5), 1e3 * percentile(ages_s, 0.99))


def _ignore(_rejected: str) -> None:
    """A refused packet shows in the age."""


def _read_input(go: threading.Event) -> None:
    """Each line, and the end of the input."""
    for _ in sys.stdin:
        go.set()
    go.set()


def main() -> None:
    config = load_agent(Path(sys.argv[1]))
    windows, window_s = int(sys.argv[2]), float(sys.argv[3])
    own_port, *other_ports = map(int, sys.argv[4:])
    go = threading.Event()
    threading.Thread(target=_read_input, args=(go,), daemon=True).start()
    link = ZenohLink(config.vehicle.id, config.fleet, config.zenoh, _ignore)
    with closing(link), closing(PlainUdp(own_port, other_ports)) as udp:
        vehicle = _Vehicle(config, link, udp)
        others = {member.id for member in config.fleet.vehicles} - {config.vehicle.id}
        while not others <= vehicle.over_zenoh.keys() & vehicle.over_udp.keys():
            vehicle.tick()
        print("heard", flush=True)
        while not go.is_set():
            vehicle.tick()
        go.clear()
        ages = [vehicle.measure(window_s) for _ in range(windows)]
        result = Result([zenoh for zenoh, _ in ages], [udp_ages for _, udp_ages in ages])
        print(msgspec.json.encode(result).decode(), flush=True)
        while not go.is_set():
            vehicle.tick()


if __name__ == "__main__":
    main()
