"""Network hosts on this machine: a namespace for each vehicle, joined by a radio that loses packets. Linux, as root.

Each namespace has a TUN interface whose other end is `Radio`, a thread of this process. So TCP, QUIC and multicast run on the
kernel's own network stack over IP packets that can be lost, also where the kernel has no netem.
"""

from __future__ import annotations

import fcntl
import heapq
import os
import select
import struct
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from ipaddress import IPv4Address
from itertools import count
from random import Random

NETWORK = "10.77.0"
TUNSETIFF, IFF_TUN, IFF_NO_PI = 0x400454CA, 0x0001, 0x1000
PACKET_BYTES = 2048
DESTINATION = slice(16, 20)  # of an IPv4 header


class HostsError(Exception):
    """The machine cannot give namespaces. str() is one line."""


@dataclass(eq=False)
class Radio(threading.Thread):
    """Passes IP packets between the hosts with `loss` (0 to 1 for each receiver) and `delay_s`. `sent_bytes` by host."""

    devices: dict[int, int]  # file descriptor by host
    loss: float
    delay_s: float
    seed: int = 1
    sent_bytes: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        super().__init__(name="radio", daemon=True)
        self._random, self._numbers, self._end = Random(self.seed), count(), threading.Event()
        self._on_the_way: list[tuple[float, int, int, bytes]] = []
        self.sent_bytes = dict.fromkeys(self.devices, 0)

    def run(self) -> None:
        host_of = {device: host for host, device in self.devices.items()}
        while not self._end.is_set():
            wait_s = self._on_the_way[0][0] - time.monotonic() if self._on_the_way else 0.1
            readable, _, _ = select.select(list(host_of), [], [], min(max(wait_s, 0.0), 0.1))
            for device in readable:
                self._send(host_of[device], os.read(device, PACKET_BYTES))
            while self._on_the_way and self._on_the_way[0][0] <= time.monotonic():
                _, _, host, packet = heapq.heappop(self._on_the_way)
                os.write(self.devices[host], packet)

    def _send(self, sender: int, packet: bytes) -> None:
        if packet[0] >> 4 != 4:
            return
        self.sent_bytes[sender] += len(packet)
        to = IPv4Address(packet[DESTINATION])
        receivers = [host for host in self.devices if host != sender and (to.is_multicast or str(to) == address(host))]
        for host in receivers:
            if self._random.random() >= self.loss:
                entry = (time.monotonic() + self.delay_s, next(self._numbers), host, packet)
                heapq.heappush(self._on_the_way, entry)

    def stop(self) -> None:
        """End the thread."""
        self._end.set()
        self.join()


def address(host: int) -> str:
    """IP address of a host."""
    return f"{NETWORK}.{host}"


def inside(host: int) -> list[str]:
    """What a command begins with that runs on this host."""
    return ["ip", "netns", "exec", namespace(host)]


@contextmanager
def hosts(numbers: Sequence[int], loss: float, delay_s: float) -> Iterator[Radio]:
    """Hosts with a radio, removed with the block. Raises HostsError."""
    with ExitStack() as undo:
        devices = {}
        for host in numbers:
            ip("netns", "add", namespace(host))
            undo.callback(ip, "netns", "delete", namespace(host))
            devices[host] = _tun(host)
            undo.callback(os.close, devices[host])
        radio = Radio(devices, loss, delay_s)
        radio.start()
        undo.callback(radio.stop)
        yield radio


def _tun(host: int) -> int:
    """The radio's end of a TUN interface, whose other end is the interface of this host."""
    name, own = f"radio{os.getpid()}.{host}"[:15], ["-n", namespace(host)]
    try:
        device = os.open("/dev/net/tun", os.O_RDWR)
        fcntl.ioctl(device, TUNSETIFF, struct.pack("16sH", name.encode(), IFF_TUN | IFF_NO_PI))
    except OSError as error:
        raise HostsError(f"/dev/net/tun: {error.strerror}; expected to run as root on Linux") from error
    ip("link", "set", name, "netns", namespace(host))
    ip(*own, "address", "add", f"{address(host)}/24", "dev", name)
    for interface in ("lo", name):
        ip(*own, "link", "set", interface, "up")
    ip(*own, "route", "add", "224.0.0.0/4", "dev", name)
    return device


def namespace(host: int) -> str:
    """Of a host of this process."""
    return f"companion-{os.getpid()}-{host}"


def ip(*arguments: str) -> None:
    """Run `ip` of iproute2. Raises HostsError."""
    try:
        done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    except FileNotFoundError as error:
        raise HostsError("ip: not found; install iproute2") from error
    if done.returncode != 0:
        raise HostsError(f"ip {' '.join(arguments)}: {done.stderr.strip()}; expected to run as root on Linux")
