"""The vehicle's MAVLink passed on to a ground station over UDP, and the ground station's to the autopilot.

The control loop never waits for it: a packet to the ground station goes out after the tick that it set off, and one to the
autopilot when the line is free, or not at all. No heartbeat is made here: the autopilot hears the ground station's own.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import NoReturn

from companion.link.endpoint import LinkError, check_host
from companion.mavlink.ground_station import GroundStationFilter

READ_BYTES = 65536
DATAGRAMS_PER_WAKE_UP = 8
PACE_S = 0.005  # one packet to the autopilot at a time, at most 200 a second
MOST_WAITING = 32  # packets; the last of them goes within 0.16 s while the line is free
LONGEST_WAIT_S = 0.25  # a command that comes later than this is better given again

ELSEWHERE = "ground station: a packet from another address"
TOO_MUCH = "ground station: more packets than the autopilot's link has room for"
NOT_HEARD = (errno.ECONNREFUSED, errno.EAGAIN)  # nobody listens there yet; the buffer is full: lost packets, no news

_log = logging.getLogger(__name__)


class GroundStationLink:
    """`offer` hands one packet to the autopilot's link, if that is free. `reject` counts what is refused, by reason."""

    def __init__(
        self,
        endpoint: str,
        admission: GroundStationFilter,
        offer: Callable[[bytes], bool],
        reject: Callable[[str], None],
    ) -> None:
        """For "udpout:HOST:PORT". Raises LinkError."""
        self._name = endpoint
        self._filter = admission
        self._offer = offer
        self._reject = reject
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._came = asyncio.Event()
        self._is_heard = False
        self._problem = ""
        self._socket, self._address = _socket_towards(endpoint)

    def pass_on(self, packets: Sequence[bytes]) -> None:
        """To the ground station, as they came; once what is due now in the event loop has been done."""
        asyncio.get_running_loop().call_soon(self._send, packets)

    async def run(self) -> NoReturn:
        """Until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._socket, self._readable)
        try:
            while True:
                await self._came.wait()
                self._came.clear()
                while self._waiting:
                    self._pass_one(time.monotonic())
                    await asyncio.sleep(PACE_S)
        finally:
            loop.remove_reader(self._socket)

    def close(self) -> None:
        self._socket.close()

    def _send(self, packets: Sequence[bytes]) -> None:
        for packet in packets:
            try:
                self._socket.sendto(packet, self._address)
            except OSError as error:
                problem = error.strerror or str(error)
                if error.errno not in NOT_HEARD and problem != self._problem:
                    self._problem = problem
                    _log.warning("ground station %s: %s", self._name, problem)
                return

    def _readable(self) -> None:
        for _ in range(DATAGRAMS_PER_WAKE_UP):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # an ICMP error about a datagram sent earlier
            if sender[:2] != self._address[:2]:
                self._reject(ELSEWHERE)
                continue
            self._take(data, time.monotonic())

    def _take(self, data: bytes, now_s: float) -> None:
        for packet in self._filter.admit(data):
            if not self._is_heard:
                self._is_heard = True
                _log.info("ground station heard from %s:%d", *self._address[:2])
            if len(self._waiting) < MOST_WAITING:
                self._waiting.append((now_s, packet))
                self._came.set()
            else:
                self._reject(TOO_MUCH)
        for reason in self._filter.refused.elements():
            self._reject(reason)
        self._filter.refused.clear()

    def _pass_one(self, now_s: float) -> None:
        """The first that is not too late, if the line takes it."""
        while self._waiting and now_s - self._waiting[0][0] > LONGEST_WAIT_S:
            self._waiting.popleft()
            self._reject(TOO_MUCH)
        if self._waiting and self._offer(self._waiting[0][1]):
            self._waiting.popleft()


def _socket_towards(endpoint: str) -> tuple[socket.socket, tuple[str, int]]:
    """A UDP socket on a port of its own, and the address: datagrams from anywhere else are not the ground station's."""
    host, _, port = endpoint.removeprefix("udpout:").rpartition(":")
    check_host(host)
    if not 0 < int(port) <= 65535:
        raise LinkError(f"port {port}, expected 1 to 65535")
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(host, int(port), type=socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise LinkError(
            f'no address is known for "{host}"; give the ground station\'s number, like 192.168.1.50'
        ) from error
    udp = socket.socket(family, kind, protocol)
    udp.setblocking(False)
    udp.bind(("", 0))
    return udp, (str(address[0]), int(address[1]))
