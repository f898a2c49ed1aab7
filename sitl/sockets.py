"""What carries a stand-in's links: UDP with one peer, and a TCP port with one client at a time."""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Iterator
from typing import cast

from sitl.autopilot import AutopilotAbortedError
from sitl.link_end import LinkEnd

MOST_WAITING_BYTES = 65_536  # for a client that does not read; what comes on top is lost


def _answers(end: LinkEnd, data: bytes) -> Iterator[bytes]:
    """The answers to what came, unless it ends the process as it ends the real program."""
    try:
        yield from end.receive(data)
    except AutopilotAbortedError as error:
        print(f"aborted by {error}", file=sys.stderr, flush=True)
        os.abort()


class UdpLink(asyncio.DatagramProtocol):
    """One UDP link. Its peer is the first that sends, for the life of the process; until then `address`."""

    def __init__(self, end: LinkEnd, address: tuple[str, int]) -> None:
        self._end = end
        self._address = address
        self._heard = False
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if not self._heard:
            self._heard, self._address = True, addr
            self._end.heard()
        elif addr != self._address:
            return
        self._send(_answers(self._end, data))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet."""

    def send_due(self) -> None:
        self._send(self._end.due())

    def _send(self, packets: Iterator[bytes]) -> None:
        for packet in packets:
            if self._transport is not None:
                self._transport.sendto(packet, self._address)


class TcpLink:
    """One TCP port. A second client is turned away.

    When the first has gone another may come, and finds the rates as they were.
    """

    def __init__(self, end: LinkEnd) -> None:
        self._end = end
        self._client: asyncio.Transport | None = None

    def accept(self) -> asyncio.Protocol:
        """The protocol of one more connection."""
        return _Client(self)

    def came(self, transport: asyncio.Transport) -> None:
        if self._client is None:
            self._client = transport
            self._end.heard()
        else:
            transport.close()

    def went(self, transport: asyncio.Transport) -> None:
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
        self._link.came(self._transport)

    def connection_lost(self, _exc: Exception | None) -> None:
        self._link.went(self._transport)

    def data_received(self, data: bytes) -> None:
        self._link.received(self._transport, data)
