"""Sockets of a stand-in's links: UDP with one peer, TCP with one client at a time.

They are read where a step begins, as an autopilot does, so that no packet wakes the process by itself.
"""

from __future__ import annotations

import contextlib
import os
import selectors
import socket
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Protocol

from sitl.autopilots.autopilot import AutopilotAbortedError
from sitl.links.link_end import LinkEnd
from sitl.links.ports import LOOPBACK

READ_BYTES = 65_536
DATAGRAMS_PER_STEP = 64  # of one link; the rest waits for the next step
MOST_WAITING_BYTES = 65_536  # for a client that does not read; further packets are dropped


class SocketLink(Protocol):
    """One link behind a socket. Its constructor registers what `receive_waiting` calls."""

    def send_due(self) -> None:
        """Send all packets that are due."""

    def close(self) -> None:
        """Close the sockets."""


def receive_waiting(selector: selectors.BaseSelector) -> None:
    """Read all sockets of this selector on which something waits, and answer."""
    for key, _ in selector.select(0):
        read: Callable[[], None] = key.data
        read()


def _answers(end: LinkEnd, data: bytes) -> Iterator[bytes]:
    """Answers to received bytes. Aborts the process, with all its stand-ins, where the real autopilot aborts."""
    try:
        yield from end.receive(data)
    except AutopilotAbortedError as error:
        print(f"vehicle {end.system_id}: aborted by {error}", file=sys.stderr, flush=True)
        os.abort()


class UdpSocketLink:
    """One UDP link. Its peer is the first sender, for the life of the process; before, packets go to `address`."""

    def __init__(self, end: LinkEnd, port: int, address: tuple[str, int], selector: selectors.BaseSelector) -> None:
        """Raises OSError for a port in use."""
        self._end = end
        self._address = address
        self._connected = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((LOOPBACK, port))
        except OSError:
            self._socket.close()
            raise
        selector.register(self._socket, selectors.EVENT_READ, self._read)

    def send_due(self) -> None:
        self._send(self._end.due())

    def close(self) -> None:
        self._socket.close()

    def _read(self) -> None:
        for _ in range(DATAGRAMS_PER_STEP):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # an ICMP error for an earlier packet: no process listens at the address yet
            if not self._connected:
                self._connected, self._address = True, sender
                self._end.peer_connected()
            if sender == self._address:
                self._send(_answers(self._end, data))

    def _send(self, packets: Iterable[bytes]) -> None:
        for packet in packets:
            with contextlib.suppress(OSError):  # also for an earlier packet; a full buffer loses this one
                self._socket.sendto(packet, self._address)


class TcpSocketLink:
    """One TCP port. A second client is rejected while the first is connected.

    A later client finds the message rates unchanged.
    """

    def __init__(self, end: LinkEnd, port: int, selector: selectors.BaseSelector) -> None:
        """Raises OSError for a port in use."""
        self._end = end
        self._selector = selector
        self._client: socket.socket | None = None
        self._waiting = b""  # for the client
        self._server = socket.create_server((LOOPBACK, port))
        self._server.setblocking(False)
        selector.register(self._server, selectors.EVENT_READ, self._accept)

    def send_due(self) -> None:
        self._send(self._end.due())

    def close(self) -> None:
        self._disconnect()
        self._server.close()

    def _accept(self) -> None:
        try:
            client, _ = self._server.accept()
        except OSError:
            return  # it has gone already
        if self._client is not None:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client
        self._selector.register(client, selectors.EVENT_READ, self._read)
        self._end.peer_connected()

    def _disconnect(self) -> None:
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
        self._client, self._waiting = None, b""

    def _read(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self._send(_answers(self._end, data))
        else:
            self._disconnect()

    def _send(self, packets: Iterable[bytes]) -> None:
        """Also without a client: what is due now is not due again."""
        data = b"".join(packets)
        if self._client is None:
            return
        if len(self._waiting) < MOST_WAITING_BYTES:
            self._waiting += data
        if not self._waiting:
            return
        try:
            self._waiting = self._waiting[self._client.send(self._waiting) :]
        except BlockingIOError:
            return
        except OSError:
            self._disconnect()
