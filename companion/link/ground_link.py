"""MAVLink relay between the autopilot and a ground station over UDP.

The control loop never waits for it. A packet to the ground station is sent after the tick that it triggered, and one to the
autopilot only while the link is free. The relay sends no heartbeat: the autopilot receives the ground station's own.
"""

from __future__ import annotations

import asyncio
import errno
import logging
import socket
import time
from collections import deque
from collections.abc import Callable, Sequence
from functools import partial
from typing import NoReturn

from companion.link.byte_links import read_waiting, resolve
from companion.mavlink.ground_station import GroundStationFilter
from companion.types.flight import FlightPhase
from companion.types.notices import Code

READ_BYTES = 2048  # ground stations send at most an Ethernet frame
DATAGRAMS_PER_WAKE_UP = 4  # the rest wakes the loop again, after a tick that may be due
PACE_S = 0.0025  # one packet to the autopilot at a time, at most 400 a second: all of motion capture and RTK at 20 Hz
MOST_WAITING = 32  # packets; the last of them is sent within 0.08 s while the link is free
LONGEST_WAIT_S = 0.25  # a command that is later than this is better repeated by the ground station
NOT_REACHED = (errno.ECONNREFUSED, errno.EAGAIN)  # no ground station yet, or a full buffer: packets lost, not logged

_log = logging.getLogger(__name__)


class GroundStationLink:
    """Relay to one ground station. `phase` is the agent's, for the filter.

    `offer` hands a packet to the autopilot's link if it is free; `reject` counts by code.
    """

    def __init__(
        self,
        endpoint: str,
        admission: GroundStationFilter,
        phase: Callable[[], FlightPhase],
        offer: Callable[[bytes], bool],
        reject: Callable[[str], None],
    ) -> None:
        """Open a socket towards "udpout:HOST:PORT". Raises LinkError."""
        self._name = endpoint
        self._filter = admission
        self._phase = phase
        self._offer = offer
        self._reject = reject
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._arrived = asyncio.Event()
        self._is_connected = False
        self._problem = ""
        self._socket, self._address = _socket_towards(endpoint)

    def pass_on(self, packets: Sequence[bytes]) -> None:
        """Send packets to the ground station, unchanged, after what is due now in the event loop."""
        asyncio.get_running_loop().call_soon(self._send, packets)

    async def run(self) -> NoReturn:
        """Relay packets to the autopilot until cancelled."""
        loop = asyncio.get_running_loop()
        loop.add_reader(self._socket, self._readable)
        try:
            while True:
                await self._arrived.wait()
                self._arrived.clear()
                while self._waiting:
                    self._pass_one(time.monotonic())
                    await asyncio.sleep(PACE_S)
        finally:
            loop.remove_reader(self._socket)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()

    def _send(self, packets: Sequence[bytes]) -> None:
        for packet in packets:
            try:
                self._socket.sendto(packet, self._address)
            except OSError as error:
                problem = error.strerror or str(error)
                if error.errno not in NOT_REACHED and problem != self._problem:
                    self._problem = problem
                    _log.warning("ground station %s: %s", self._name, problem)
                return

    def _readable(self) -> None:
        for data, sender in read_waiting(partial(self._socket.recvfrom, READ_BYTES), DATAGRAMS_PER_WAKE_UP):
            if sender[:2] == self._address[:2]:
                self._take(data, time.monotonic())
            else:
                self._reject(Code.GROUND_STATION_ADDRESS)

    def _take(self, data: bytes, now_s: float) -> None:
        for packet in self._filter.admit(data, self._phase()):
            if not self._is_connected:
                self._is_connected = True
                _log.info("ground station at %s:%d", *self._address[:2])
            if len(self._waiting) < MOST_WAITING:
                self._waiting.append((now_s, packet))
                self._arrived.set()
            else:
                self._reject(Code.GROUND_STATION_OVERLOAD)
        for code in self._filter.refused.elements():
            self._reject(code)
        self._filter.refused.clear()

    def _pass_one(self, now_s: float) -> None:
        """Send the first packet that has not waited too long, if the link is free."""
        while self._waiting and now_s - self._waiting[0][0] > LONGEST_WAIT_S:
            self._waiting.popleft()
            self._reject(Code.GROUND_STATION_OVERLOAD)
        if self._waiting and self._offer(self._waiting[0][1]):
            self._waiting.popleft()


def _socket_towards(endpoint: str) -> tuple[socket.socket, tuple[str, int]]:
    """A UDP socket on its own port, and the address of the ground station."""
    host, _, port = endpoint.removeprefix("udpout:").rpartition(":")
    hint = f'no address found for "{host}"; give the ground station\'s IP address, like 192.168.1.50'
    family, kind, protocol, address = resolve(host, int(port), hint)
    udp = socket.socket(family, kind, protocol)
    udp.setblocking(False)
    udp.bind(("", 0))
    return udp, (str(address[0]), int(address[1]))
