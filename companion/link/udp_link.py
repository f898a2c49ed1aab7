"""MAVLink over UDP: listens on a port and answers the first autopilot that sends there."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import socket
import struct
import time

from companion.link.endpoint import AllRead, LinkError, Received, encoded_host, explain

DATAGRAM_BYTES = 4096  # of a datagram: autopilots send at most an Ethernet frame
DATAGRAMS_PER_WAKE_UP = 64  # the rest wakes the loop again, after a tick that may be due
BYTES_PER_WAKE_UP = 8192  # some 200 messages: 2 ms
RELOCK_AFTER_S = 5.0  # a restarted autopilot may send from another port

_SO_TIMESTAMPNS = 35  # Linux; missing in the socket module
_TIMESPEC = struct.Struct("@ll")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)


class UdpLink:
    """Listens and answers only the address that first sent packets of the autopilot.

    Times of arrival are the kernel's: datagrams that waited during a pause of this process keep their true age.
    """

    def __init__(self, host: str, port: int, received: Received, all_read: AllRead) -> None:
        self._received, self._all_read = received, all_read
        self._socket = _bound_udp_socket(host, port)
        self._autopilot: tuple[str, int] | None = None
        self._heard_s = float("-inf")
        self._anything_arrived = False

    def send(self, data: bytes) -> None:
        if self._autopilot:
            # ConnectionRefused refers to an earlier datagram, BlockingIOError to a full buffer: both are lost packets.
            with contextlib.suppress(OSError):
                self._socket.sendto(data, self._autopilot)

    def offer(self, data: bytes) -> bool:
        self.send(data)
        return self._autopilot is not None

    async def run(self) -> None:
        loop = asyncio.get_running_loop()
        loop.add_reader(self._socket, self._readable)
        try:
            await loop.create_future()
        finally:
            loop.remove_reader(self._socket)

    def problem(self) -> str:
        if self._anything_arrived:
            return "packets arrived, none of them from this autopilot; check its id (MAV_SYS_ID)"
        return "nothing arrived; is the autopilot running, and does it send to this port?"

    def close(self) -> None:
        self._socket.close()

    def _readable(self) -> None:
        self._read_waiting()
        self._all_read()

    def _read_waiting(self) -> None:
        read_bytes = 0
        for _ in range(DATAGRAMS_PER_WAKE_UP):
            if read_bytes > BYTES_PER_WAKE_UP:
                return
            try:
                data, ancillary, _, sender = self._socket.recvmsg(DATAGRAM_BYTES, _ANCILLARY_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # ICMP error for a datagram sent earlier
            read_bytes += len(data)
            self._datagram(data, _arrival_s(ancillary), sender)

    def _datagram(self, data: bytes, received_s: float, sender: tuple[str, int]) -> None:
        self._anything_arrived = True
        is_locked = self._autopilot is not None and received_s - self._heard_s < RELOCK_AFTER_S
        if is_locked and sender != self._autopilot:
            return
        if self._received(data, received_s):
            if sender != self._autopilot:
                self._autopilot = sender
                logging.getLogger(__name__).info("autopilot at %s:%d", *sender[:2])
            self._heard_s = received_s


def _bound_udp_socket(host: str, port: int) -> socket.socket:
    name = encoded_host(host)
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(name, port, type=socket.SOCK_DGRAM)[0]
    except socket.gaierror as error:
        raise LinkError(f'"{host}" is not an address of this machine; use 0.0.0.0 for all of them') from error
    udp = socket.socket(family, kind, protocol)
    try:
        udp.bind(address)
    except OSError as error:
        udp.close()
        raise LinkError(explain(error, f"UDP port {port}")) from error
    udp.setblocking(False)
    with contextlib.suppress(OSError):  # not Linux: the time of reading is used instead
        udp.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
    return udp


def _arrival_s(ancillary: list[tuple[int, int, bytes]]) -> float:
    """Time at which the kernel received the datagram, on the monotonic clock; never later than now."""
    now_s = time.monotonic()
    for level, kind, value in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(value) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(value)
            waited_s = (time.time_ns() - int(seconds) * 1_000_000_000 - int(nanoseconds)) * 1e-9
            return now_s - max(0.0, waited_s)
    return now_s
