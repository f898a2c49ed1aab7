"""Sockets of a stand-in's links: UDP with one peer, TCP with one client at a time."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from typing import cast

from sitl.autopilots.autopilot import AutopilotAbortedError
from sitl.links.link_end import LinkEnd

MOST_WAITING_BYTES = 65_536  # for a client that does not read; further packets are dropped


def _answers(end: LinkEnd, data: bytes) -> Iterator[bytes]:
    """Answers to received bytes. Aborts the process where the real autopilot aborts."""
    try:
        yield from end.receive(data)
    except AutopilotAbortedError as error:
        print(f"aborted by {error}", file=sys.stderr, flush=True)
        os.abort()


class UdpLink(asyncio.DatagramProtocol):
    """One UDP link. Its peer is the first sender, for the life of the process; before, packets go to `address`."""

    def __init__(self, end: LinkEnd, address: tuple[str, int]) -> None:
        self._end = end
        self._address = address
        self._connected = False
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if not self._connected:
            self._connected, self._address = True, addr
            self._end.peer_connected()
        elif addr != self._address:
            return
        self._send(_answers(self._end, data))

    def error_received(self, exc: Exception) -> None:
        """No process listens at the address yet."""

    def send_due(self) -> None:
        self._send(self._end.due())

    def _send(self, packets: Iterator[bytes]) -> None:
        for packet in packets:
            if self._transport is not None:
                self._transport.sendto(packet, self._address)


class TcpLink:
    """One TCP port. A second client is rejected while the first is connected.

    A later client finds the message rates unchanged.
    """

    def __init__(self, end: LinkEnd) -> None:
        self._end = end
        self._client: asyncio.Transport | None = None

    def accept(self) -> asyncio.Protocol:
        """The protocol of a new connection."""
        return _Client(self)

    def connected(self, transport: asyncio.Transport) -> None:
        if self._client is None:
            self._client = transport
            self._end.peer_connected()
        else:
            transport.close()

    def disconnected(self, transport: asyncio.Transport) -> None:
        if transport is self._client:
            self._client = None

    def received(self, transport: asyncio.Transport, data: bytes) -> None:
        if transport is self._client:
            self._send(_answers(self._end, data))

    def send_due(self) -> None:
        self._send(self._end.due())

    def _send(self, packets: Iterator[bytes]) -> None:
        data = b"".join(packets)
        if data and self._client is not None and self._client.get_write_buffer_size() < MOST_WAITING_BYTES:
            self._client.write(data)


class _Client(asyncio.Protocol):
    """One connection to a TcpLink."""

    def __init__(self, link: TcpLink) -> None:
        self._link = link

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.Transport, transport)
        self._link.connected(self._transport)

    def connection_lost(self, _exc: Exception | None) -> None:
        self._link.disconnected(self._transport)

    def data_received(self, data: bytes) -> None:
        self._link.received(self._transport, data)
