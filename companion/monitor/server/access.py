"""Who may ask the server for what. It is reached by browsers, so any page that the operator visits may try.

- The name in Host is the server's own: another page cannot make the browser believe that this server is its own (DNS
  rebinding).
- A POST and a WebSocket that name an Origin name that of this server: another page cannot send in the operator's name.
- A command needs the token of the printed URL.
- The page may load and run what this server has, and nothing else.
"""

from __future__ import annotations

import hmac
import logging
import re
import socket
from ipaddress import ip_address

import msgspec
from aiohttp import web
from aiohttp.typedefs import Handler, Middleware

from companion.monitor.api import TOKEN_HEADER

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
_HOST = re.compile(r"(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+)(:\d{1,5})?")


def error(status: int, text: str) -> web.Response:
    """An answer that is no success: one line as JSON."""
    body = msgspec.json.encode({"error": text})
    return web.Response(status=status, body=body, content_type="application/json")


def is_loopback(address: str) -> bool:
    """Whether only this machine reaches an address."""
    try:
        return ip_address(address.strip("[]")).is_loopback
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
    except web.HTTPException as answer:  # of aiohttp: an unknown path or method
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
