"""How many connections the server holds. One that sends no request costs nothing, and may not keep an operator out."""

from __future__ import annotations

import asyncio
import socket

from aiohttp import web
from aiohttp.typedefs import Handler
from aiohttp.web_protocol import RequestHandler

MOST_CONNECTIONS = 128  # the WebSockets among them; a process may have 1024 open files, those of Zenoh among them


class Connections:
    """At most MOST_CONNECTIONS, and those that come at the same moment. For a new one the oldest that waits for a request ends.

    Who waits cannot be told from who means harm. A browser whose idle connection has ended opens another one.
    """

    def __init__(self) -> None:
        self._busy: set[RequestHandler] = set()

    @web.middleware
    async def watch(self, request: web.Request, handler: Handler) -> web.StreamResponse:
        """Around every request: a connection is busy until it is answered, a WebSocket until it ends."""
        self._busy.add(request.protocol)
        try:
            return await handler(request)
        finally:
            self._busy.discard(request.protocol)

    async def accept(self, runner: web.AppRunner, listening: socket.socket) -> asyncio.Server:
        """Serve a bound socket by a runner that is set up, until the result is closed."""
        server = runner.server
        assert server is not None

        def accepted() -> RequestHandler:
            self._make_room(server)
            return server()

        return await asyncio.get_running_loop().create_server(accepted, sock=listening)

    def _make_room(self, server: web.Server) -> None:
        open_ones = [one for one in server.connections if one.transport and not one.transport.is_closing()]
        if len(open_ones) < MOST_CONNECTIONS:
            return
        for one in open_ones:  # the oldest first
            if one not in self._busy and one.transport:
                one.transport.abort()
                return
