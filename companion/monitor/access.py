"""Who may ask the server for what, and how many at once. It is reached by browsers: any page that the operator visits may try.

- The name in Host is the server's own: another page cannot make the browser believe that this server is its own (DNS
  rebinding).
- A POST and a WebSocket that name an Origin name that of this server: another page cannot send in the operator's name.
- A command needs the token of the printed URL.
- The page may load and run what this server has, and nothing else.
- Connections and WebSocket clients are bounded, and places are kept for the operator. A slow client misses snapshots;
  nothing is queued for it.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import logging
import re
import socket
from collections import Counter
from collections.abc import Callable
from ipaddress import ip_address

import msgspec
from aiohttp import WSCloseCode, WSMsgType, web
from aiohttp.typedefs import Handler, Middleware
from aiohttp.web_protocol import RequestHandler

from companion.monitor.api import LIVE_PROTOCOL, TOKEN_HEADER, TOKEN_PROTOCOL, ClientMessage
from companion.monitor.places import Places, Share, Visitor, network_of, plain_address

POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; font-src 'self'; "
    "media-src 'self' data: blob:; connect-src 'self'; manifest-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
HEADERS = {
    "Content-Security-Policy": POLICY,
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), geolocation=(), microphone=()",
    "Server": "companion",
}
PLAIN_HEADERS = (TOKEN_HEADER, "Sec-WebSocket-Key", "Sec-WebSocket-Version", "Sec-WebSocket-Protocol")
LOCAL_NAMES = frozenset({"localhost", "127.0.0.1", "::1"})
_log = logging.getLogger(__name__)
# Of a WebSocket whose subprotocols are not ours: a stranger's words, or the token, for the operator's terminal.
logging.getLogger("aiohttp.websocket").addFilter(lambda record: "overlap" not in str(record.msg))
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")


def error(status: int, text: str) -> web.Response:
    """An answer that is no success: one line as JSON."""
    body = msgspec.json.encode({"error": text})
    return web.Response(status=status, body=body, content_type="application/json")


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ip_address(plain_address(address)).is_loopback
    except ValueError:
        return address == "localhost"


def own_names() -> frozenset[str]:
    """Names by which this machine is reached, besides its addresses."""
    host = socket.gethostname().lower()
    return LOCAL_NAMES | {host, f"{host.partition('.')[0]}.local", host.partition(".")[0]}


def guard(listen_address: str) -> Middleware:
    """The middleware in front of every handler."""
    names = own_names() | {listen_address.strip("[]").lower()}

    @web.middleware
    async def check(request: web.Request, handler: Handler) -> web.StreamResponse:
        return refusal_of(request, names) or await _handled(request, handler)

    return check


async def add_headers(_request: web.Request, response: web.StreamResponse) -> None:
    """To every answer; nothing is kept in a cache where its handler does not say so."""
    response.headers.update(HEADERS)
    response.headers.setdefault("Cache-Control", "no-store")


async def _handled(request: web.Request, handler: Handler) -> web.StreamResponse:
    try:
        return await handler(request)
    except web.HTTPRequestEntityTooLarge:
        return error(413, "the request is too long")
    except web.HTTPException as answer:  # raised by aiohttp: an unknown path or method
        return error(answer.status, f"{request.method} {request.path[:200]}: {answer.reason}")
    except web.RequestPayloadError:
        return error(400, "the body cannot be read; expected it as Content-Encoding and Content-Length say")
    except Exception:
        if request.writer.output_size:  # a part of the answer is sent already
            raise
        _log.exception("%s %s", request.method, request.path[:200])
        return error(500, "a fault of this server; the terminal of companion monitor has the reason")


def refusal_of(request: web.Request, names: frozenset[str]) -> web.Response | None:
    """None for a request by a name of this server, from its own page or from no page at all, with headers of plain text."""
    host = request.headers.get("Host", "")
    found = _HOST.fullmatch(host)
    name = found[1].strip("[]").lower() if found else ""
    if name not in names and name != _reached_address(request):
        return error(
            403, "Host is not this server; use the URL that companion monitor printed, or name it: --listen NAME:PORT"
        )
    origin = request.headers.get("Origin")
    changes = request.method not in ("GET", "HEAD") or request.headers.get("Upgrade") is not None
    if changes and origin is not None and origin not in (f"http://{host}", f"https://{host}"):
        return error(403, "Origin is another page; only the page of this server may do this")
    for header in PLAIN_HEADERS:
        if not request.headers.get(header, "").isascii():
            return error(400, f"{header}: has other characters; expected ASCII text")
    return None


def _reached_address(request: web.Request) -> str:
    """The own address that the connection came to."""
    transport = request.transport
    own = transport.get_extra_info("sockname") if transport else None
    return str(own[0]).lower().removeprefix("::ffff:") if own else ""  # IPv4 that came to an IPv6 socket


def has_token(request: web.Request, token: str) -> bool:
    """Compared in constant time."""
    return hmac.compare_digest(request.headers.get(TOKEN_HEADER, "").encode(), token.encode())


def has_socket_token(request: web.Request, token: str) -> bool:
    """Likewise for a WebSocket: a browser can give one no header of its own, but subprotocols."""
    wanted = (TOKEN_PROTOCOL + token).encode()
    return has_token(request, token) or any(hmac.compare_digest(one.encode(), wanted) for one in _protocols(request))


def _protocols(request: web.Request) -> list[str]:
    """The first subprotocols that a WebSocket offers."""
    return [one.strip() for one in request.headers.get("Sec-WebSocket-Protocol", "").split(",", 4)[:4]]


MOST_CONNECTIONS = 128  # the WebSockets among them; a process may have 1024 open files, those of Zenoh among them


class Connections:
    """At most MOST_CONNECTIONS, and those that come at the same moment. For a new one another that waits for a request ends.

    That is the oldest of whom most are waiting, so that one address keeps no other from sending its request. A browser
    whose idle connection has ended opens another one.
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
        waiting = [(_owner(one), one) for one in open_ones if one not in self._busy]  # the oldest first
        count = Counter(owner for owner, _ in waiting)
        _, oldest = max(waiting, key=lambda one: count[one[0]], default=("", None))
        if oldest and oldest.transport:
            oldest.transport.abort()


def _owner(connection: RequestHandler) -> str:
    """Whose it is: an address, of IPv6 the network of which a host can take any address."""
    peer = connection.transport.get_extra_info("peername") if connection.transport else None
    address = plain_address(str(peer[0])) if peer else ""
    return network_of(address) or address


MOST_CLIENTS = 32  # those of the operator; others have places of their own
MOST_OF_ADDRESS = 8  # of others
CLOSE_ONE = "close one of them"
FOR_TOKEN = Share(MOST_CLIENTS, MOST_CLIENTS // 2, MOST_CLIENTS, " with the token", CLOSE_ONE)
FOR_THIS_MACHINE = Share(MOST_CLIENTS, MOST_CLIENTS, MOST_CLIENTS, "", CLOSE_ONE)  # of a server without a token
FOR_OTHERS = Share(24, MOST_OF_ADDRESS, 16, "", CLOSE_ONE)
WITHOUT_TOKEN = Share(
    24, MOST_OF_ADDRESS, 16, " without the token", f"{CLOSE_ONE}, or open the URL that companion monitor printed last"
)
LONGEST_MESSAGE = 1024  # bytes of a client message
SEND_WITHIN_S = 10.0  # a client that takes longer for one snapshot is closed
LEAVE_WITHIN_S = 0.3  # at the end of the server
ALIVE_S = 15.0  # a client is asked whether it is there

_decoder = msgspec.json.Decoder(ClientMessage)


def visitor_of(request: web.Request, token: str) -> Visitor:
    """`token` is "" for a server without control; there the operator is who sits at this machine."""
    address = plain_address(str(request.remote))
    if token:
        return Visitor(address, FOR_TOKEN if has_socket_token(request, token) else WITHOUT_TOKEN)
    here = is_loopback(address) or address == _reached_address(request)
    return Visitor(address, FOR_THIS_MACHINE if here else FOR_OTHERS)


class Clients:
    """Those of the operator and those of others have places of their own; one address of others gets a few."""

    def __init__(self) -> None:
        self._clients: set[_Client] = set()
        self._places = Places()

    def refusal(self, visitor: Visitor) -> str:
        """Why there is no place, in one line, or ""."""
        return self._places.refusal(visitor)

    @property
    def count(self) -> int:
        return len(self._clients)

    def publish(self, snapshot: bytes) -> None:
        """The same bytes to all. A client that still sends an older snapshot gets this one, or a newer one, after it."""
        for client in self._clients:
            client.offer(snapshot)

    async def serve(
        self, request: web.Request, visitor: Visitor, first: bytes, act: Callable[[ClientMessage], None]
    ) -> web.StreamResponse:
        """Until the client leaves; it has a place. `act` gets its messages; a message that is none ends the connection."""
        with self._places.taken_by(visitor):
            return await self._serve(request, first, act)

    async def _serve(
        self, request: web.Request, first: bytes, act: Callable[[ClientMessage], None]
    ) -> web.StreamResponse:
        socket = web.WebSocketResponse(
            max_msg_size=LONGEST_MESSAGE, heartbeat=ALIVE_S, compress=False, timeout=2.0, protocols=(LIVE_PROTOCOL,)
        )
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
