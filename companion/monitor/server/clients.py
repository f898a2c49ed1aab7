"""The WebSocket clients: each gets the newest snapshot. A slow one misses some; nothing is queued for it."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web

from companion.monitor.api import ClientMessage

MOST_CLIENTS = 32
LONGEST_MESSAGE = 1024  # bytes of a client message
SEND_WITHIN_S = 10.0  # a client that takes longer for one snapshot is closed
LEAVE_WITHIN_S = 0.3  # at the end of the server
ALIVE_S = 15.0  # a client is asked whether it is there

_decoder = msgspec.json.Decoder(ClientMessage)


class Clients:
    """At most MOST_CLIENTS."""

    def __init__(self) -> None:
        self._clients: set[_Client] = set()

    @property
    def is_full(self) -> bool:
        return len(self._clients) >= MOST_CLIENTS

    def publish(self, snapshot: bytes) -> None:
        """The same bytes to all. A client that still sends an older snapshot gets this one, or a newer one, after it."""
        for client in self._clients:
            client.offer(snapshot)

    async def serve(
        self, request: web.Request, first: bytes, act: Callable[[ClientMessage], None]
    ) -> web.StreamResponse:
        """Until the client leaves. `act` gets its messages; a message that is none ends the connection."""
        socket = web.WebSocketResponse(max_msg_size=LONGEST_MESSAGE, heartbeat=ALIVE_S, compress=False, timeout=2.0)
        await socket.prepare(request)
        assert request.transport is not None  # the answer to the upgrade went through it
        client = _Client(socket, request.transport)
        client.offer(first)
        self._clients.add(client)
        sending = asyncio.create_task(client.send_newest())
        try:
            await _receive(socket, act)
        finally:
            self._clients.discard(client)
            sending.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await sending
        return socket

    async def close(self) -> None:
        """All of them, as the server ends."""
        leaving = [client.socket.close(code=WSCloseCode.GOING_AWAY) for client in self._clients]
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.gather(*leaving, return_exceptions=True), LEAVE_WITHIN_S)


class _Client:
    def __init__(self, socket: web.WebSocketResponse, transport: asyncio.Transport) -> None:
        self.socket = socket
        self._transport = transport
        self._newest = b""
        self._offered = asyncio.Event()

    def offer(self, snapshot: bytes) -> None:
        self._newest = snapshot
        self._offered.set()

    async def send_newest(self) -> None:
        """Without end; a client that cannot be sent to is closed."""
        try:
            while True:
                await self._offered.wait()
                self._offered.clear()
                async with asyncio.timeout(SEND_WITHIN_S):
                    await self.socket.send_frame(self._newest, WSMsgType.TEXT)
        except (TimeoutError, ConnectionError):
            self._transport.abort()  # a close frame would wait behind what the client does not read


async def _receive(socket: web.WebSocketResponse, act: Callable[[ClientMessage], None]) -> None:
    async for message in socket:
        try:
            if message.type is not WSMsgType.TEXT:
                raise msgspec.DecodeError("expected text")
            act(_decoder.decode(message.data))
        except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
            await socket.close(code=WSCloseCode.UNSUPPORTED_DATA, message=str(error).encode()[:120])
            return
