"""The emulated network between agents: real sockets, lost datagrams, streams that stall, partitions."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest

from common import until
from processes import free_fleet_offset
from sitl.links.emulated_network import emulated_host
from sitl.links.ports import LOOPBACK, ports_of

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="127.0.0.0/8 is loopback on Linux only")

Setting = float | list[dict[str, object]]


@dataclass
class Running:
    """A network of vehicles 1 and 2; vehicle 2 reaches vehicle 1 at `address`."""

    process: subprocess.Popen[bytes]
    file: Path
    log: Path
    port_offset: int

    @property
    def port(self) -> int:
        return ports_of(1, self.port_offset).zenoh

    @property
    def address(self) -> tuple[str, int]:
        return emulated_host(1, 2), self.port

    def change(self, **links: Setting) -> None:
        before = self.log.read_text().count("links changed")
        write(self.file, self.port_offset, links)
        self.process.send_signal(signal.SIGHUP)
        until(lambda: self.log.read_text().count("links changed") > before)


def write(file: Path, port_offset: int, links: dict[str, Setting]) -> None:
    file.write_text(json.dumps({"vehicles": [1, 2], "links": links, "port_offset": port_offset}), encoding="utf-8")


@pytest.fixture
def network(tmp_path: Path) -> Iterator[Callable[..., Running]]:
    processes = []

    def start(**links: Setting) -> Running:
        port_offset = free_fleet_offset()
        file, log = tmp_path / "network.yaml", tmp_path / "network.log"
        write(file, port_offset, links)
        with log.open("wb") as output:
            command = [sys.executable, "-m", "sitl.links.emulated_network", str(file)]
            processes.append(subprocess.Popen(command, stdout=output, stderr=output))
        until(lambda: "network of vehicles 1, 2" in log.read_text() or processes[-1].poll() is not None)
        assert processes[-1].poll() is None, log.read_text()
        return Running(processes[-1], file, log, port_offset)

    yield start
    for process in processes:
        process.terminate()
        assert process.wait(5.0) == 0


@contextmanager
def datagrams(running: Running) -> Iterator[Callable[[int], list[int]]]:
    """Send this many datagrams to vehicle 1, one per millisecond. Returns those that arrived, in their order."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind((LOOPBACK, running.port))

        def exchange(number: int) -> list[int]:
            arrived = list[int]()

            def receive(timeout_s: float) -> None:
                receiver.settimeout(timeout_s)
                with suppress(TimeoutError):
                    while True:
                        arrived.append(int(receiver.recv(100)))

            for index in range(number):
                sender.sendto(str(index).encode(), running.address)
                receive(0.001)
            receive(0.3)
            return arrived

        yield exchange


def test_datagrams_are_lost_duplicated_and_reordered(network: Callable[..., Running]) -> None:
    running = network(peer_loss=0.3)
    with datagrams(running) as exchange:
        arrived = exchange(1000)
        assert 640 < len(arrived) < 760
        assert arrived == sorted(set(arrived))
        running.change(peer_duplicates=0.5)
        assert len(arrived := exchange(200)) > 260
        assert set(arrived) == set(range(200))
        running.change(peer_jitter_s=0.05)
        arrived = exchange(200)
        assert arrived != sorted(arrived)
        assert sorted(arrived) == list(range(200))


def test_a_partition_stops_datagrams_until_it_heals(network: Callable[..., Running]) -> None:
    running = network()
    with datagrams(running) as exchange:
        assert len(exchange(20)) == 20
        running.change(partitions=[{"vehicles": [1], "from_s": 0.0, "until_s": 3600.0}])
        assert exchange(20) == []
        running.change()
        assert len(exchange(20)) == 20


@contextmanager
def echo_server(port: int) -> Iterator[None]:
    def serve(listener: socket.socket) -> None:
        connection, _ = listener.accept()
        with connection:
            while data := connection.recv(4096):
                connection.sendall(data)

    with socket.create_server((LOOPBACK, port)) as listener:
        thread = threading.Thread(target=serve, args=[listener])
        thread.start()
        yield
        thread.join(5.0)
        assert not thread.is_alive()


def test_streams_lose_no_bytes_and_stall_instead(network: Callable[..., Running]) -> None:
    running = network(peer_loss=0.3)
    with echo_server(running.port), socket.create_connection(running.address) as connection:
        connection.settimeout(20.0)
        sent, echoed, slowest_s = b"", b"", 0.0
        for index in range(40):
            line = b"%d " % index
            began_s = time.monotonic()
            connection.sendall(line)
            sent += line
            while len(echoed) < len(sent):
                echoed += connection.recv(4096)
            slowest_s = max(slowest_s, time.monotonic() - began_s)
        assert echoed == sent
        assert slowest_s > 0.2  # a retransmission was lost, too


def test_a_stream_waits_for_the_end_of_a_partition(network: Callable[..., Running]) -> None:
    running = network()
    with echo_server(running.port), socket.create_connection(running.address) as connection:
        connection.settimeout(5.0)
        connection.sendall(b"before")
        assert connection.recv(100) == b"before"
        running.change(partitions=[{"vehicles": [2], "from_s": 0.0, "until_s": 3600.0}])
        connection.sendall(b"during")
        connection.settimeout(0.4)
        with pytest.raises(TimeoutError):
            connection.recv(100)
        running.change()
        connection.settimeout(5.0)
        assert connection.recv(100) == b"during"


def test_the_end_of_one_end_closes_the_other(network: Callable[..., Running]) -> None:
    running = network()
    with echo_server(running.port), socket.create_connection(running.address) as connection:
        connection.sendall(b"x")
        assert connection.recv(100) == b"x"
    # The server's thread has ended: it received the end of the stream.


def test_an_unreadable_file_changes_nothing(network: Callable[..., Running]) -> None:
    running = network(peer_loss=1.0)
    running.file.write_text("links: {peer_loss: 7}", encoding="utf-8")
    os.kill(running.process.pid, signal.SIGHUP)
    until(lambda: "peer_loss" in running.log.read_text())
    with datagrams(running) as exchange:
        assert exchange(20) == []
