"""Datagrams from one agent to another: a UDP port for the sender that passes them on over a disturbed path."""

from __future__ import annotations

import asyncio
import socket
from contextlib import suppress

from sitl.links.impairment import Path

DATAGRAM_BYTES = 65_535


class EmulatedDatagrams:
    """Listens on `front` and forwards to `back`, where the receiver listens. Flight time begins at `epoch_s` of the loop."""

    def __init__(self, front: tuple[str, int], back: tuple[str, int], path: Path, epoch_s: float) -> None:
        """Raises OSError where `front` cannot be bound."""
        self._loop = asyncio.get_running_loop()
        self._back, self._path, self._epoch_s = back, path, epoch_s
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(front)
        self._socket.setblocking(False)
        self._loop.add_reader(self._socket, self._readable)

    def _readable(self) -> None:
        with suppress(OSError):  # ICMP error: the receiver does not listen yet
            data = self._socket.recv(DATAGRAM_BYTES)
            for arrives_s in self._path.arrivals_s(self._loop.time() - self._epoch_s):
                self._loop.call_at(self._epoch_s + arrives_s, self._deliver, data)

    def _deliver(self, data: bytes) -> None:
        with suppress(OSError):
            self._socket.sendto(data, self._back)
