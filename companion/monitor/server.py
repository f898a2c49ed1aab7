"""The server of the live page: its addresses and what each answers, its files, and its run. docs/api.md has the addresses."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import logging
import re
import secrets
import signal
import socket
import sys
from collections.abc import Awaitable, Callable, Coroutine, Iterable, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import msgspec
from aiohttp import web
from aiohttp.http_exceptions import HttpProcessingError
from msgspec import Struct

from companion.config.validation import in_plain_words
from companion.geometry.formations import SHAPES
from companion.monitor import MonitorError
from companion.monitor.access import (
    Clients,
    Connections,
    add_headers,
    error,
    guard,
    has_token,
    is_loopback,
    visitor_of,
)
from companion.monitor.api import CommandRequest, ControlView
from companion.monitor.command_requests import reference_forms
from companion.monitor.commander import Commander
from companion.monitor.ground_logs import GroundLogs
from companion.monitor.station import Station
from companion.monitor.tiles import DEEPEST_ZOOM, Tiles, content_type
from companion.types.commands import CommandName
from companion.types.flight import RULES
from companion.types.values import quoted
from companion.types.vehicle_looks import COLOURS, DASHES, ink_on

LONGEST_BODY = 64 * 1024  # bytes: a formation of 250 vehicles has 15 kB
VIEW_ONLY = "this server shows and does not command; start it with: companion monitor --control"
WRONG_TOKEN = "the token is missing or wrong; open the URL that companion monitor --control printed"

T = TypeVar("T")
_encoder = msgspec.json.Encoder()


class Site:
    """The handlers. `commander` is None without --control; then `token` is not used."""

    def __init__(
        self,
        station: Station,
        commander: Commander | None,
        token: str,
        tiles: Tiles | None,
        logs: GroundLogs | None = None,
    ) -> None:
        self._station = station
        self._logs = logs or GroundLogs()
        self._commander = commander
        self._token = token
        self._tiles = tiles
        self._files = page_files()
        self._encoded = _encoder.encode(station.newest)
        self.clients = Clients()
        self.connections = Connections()
        station.publish = self._publish

    def app(self, listen_address: str) -> web.Application:
        middlewares = [self.connections.watch, guard(listen_address)]
        app = web.Application(middlewares=middlewares, client_max_size=LONGEST_BODY)
        app.on_response_prepare.append(add_headers)
        api = "/api/v1"
        app.add_routes(
            [
                web.get(f"{api}/live", self._live),
                web.get(f"{api}/snapshot", self._snapshot),
                web.get(f"{api}/history", self._history),
                web.get(f"{api}/flight", self._flight),
                web.get(f"{api}/fleets/{{name}}", self._fleet),
                web.get(f"{api}/logs", self._list_logs),
                web.get(rf"{api}/logs/{{id:[0-9a-f]{{16}}}}", self._log),
                web.get(f"{api}/control", self._control),
                web.post(f"{api}/commands", self._command),
                web.post(f"{api}/preview", self._preview),
                web.post(rf"{api}/alarms/{{id:\d{{1,9}}}}/acknowledge", self._acknowledge),
                web.get(r"/tiles/{z:\d{1,2}}/{x:\d{1,8}}/{y:\d{1,8}}.png", self._tile),
                web.get("/metrics", self._metrics),
                web.get("/{path:(?!api/|tiles/).*}", self._page),
            ]
        )
        return app

    def _publish(self, snapshot: bytes) -> None:
        self._encoded = snapshot
        self.clients.publish(snapshot)

    async def _live(self, request: web.Request) -> web.StreamResponse:
        """A browser does not tell its page why a WebSocket was refused; a plain GET does."""
        visitor = visitor_of(request, self._token if self._commander else "")
        if refused := self.clients.refusal(visitor):
            return error(503, refused)
        if not web.WebSocketResponse().can_prepare(request):
            return error(426, "expected a WebSocket; GET /api/v1/snapshot gives one snapshot")
        return await self.clients.serve(request, visitor, self._encoded, self._station.act)

    async def _snapshot(self, _request: web.Request) -> web.StreamResponse:
        return _json(self._station.newest)

    async def _history(self, _request: web.Request) -> web.StreamResponse:
        return _json(self._station.history())

    async def _flight(self, _request: web.Request) -> web.StreamResponse:
        flight = await self._station.flight()
        return (
            error(404, "this is no replay; GET /api/v1/history has the events kept")
            if flight is None
            else _json(flight)
        )

    async def _fleet(self, request: web.Request) -> web.StreamResponse:
        view = self._station.fleet_map(request.match_info["name"])
        if view is None:
            known = ", ".join(self._station.fleet_names) or "none; give one with --fleet-file"
            return error(404, f"this server has no such fleet file; it has: {known}")
        return _json(msgspec.structs.replace(view, tiles=self._tiles.view if self._tiles else None))

    async def _list_logs(self, _request: web.Request) -> web.StreamResponse:
        return _json(await asyncio.to_thread(self._logs.listed))

    async def _log(self, request: web.Request) -> web.StreamResponse:
        """A file of the list. The request has no part in its path."""
        path = await asyncio.to_thread(self._logs.path, request.match_info["id"])
        if path is None:
            return error(404, "no such log; GET /api/v1/logs lists them")
        headers = {
            "Content-Type": "application/octet-stream",
            "Content-Disposition": f'attachment; filename="{path.name}"',
        }
        return web.FileResponse(path, headers=headers)

    async def _acknowledge(self, request: web.Request) -> web.StreamResponse:
        if self._commander and not has_token(request, self._token):
            return error(403, WRONG_TOKEN)
        alarm = self._station.acknowledge(int(request.match_info["id"]))
        return error(404, "no such alarm; it has ended") if alarm is None else _json(alarm)

    async def _control(self, request: web.Request) -> web.StreamResponse:
        return _json(ControlView(self._commander is not None and has_token(request, self._token)))

    async def _command(self, request: web.Request) -> web.StreamResponse:
        return await self._by_commander(request, Commander.send)

    async def _preview(self, request: web.Request) -> web.StreamResponse:
        return await self._by_commander(request, Commander.preview)

    async def _by_commander(self, request: web.Request, act: Callable[..., Awaitable[Struct]]) -> web.StreamResponse:
        if self._commander is None or not has_token(request, self._token):
            return error(403, WRONG_TOKEN if self._commander else VIEW_ONLY)
        wanted = await _body(request, CommandRequest)
        return wanted if isinstance(wanted, web.Response) else _json(await act(self._commander, wanted))

    async def _tile(self, request: web.Request) -> web.StreamResponse:
        return await tile(request, self._tiles)

    async def _page(self, request: web.Request) -> web.StreamResponse:
        return await page_file(request, self._files)

    async def _metrics(self, _request: web.Request) -> web.StreamResponse:
        try:
            from companion.monitor.metrics import CONTENT_TYPE, exposition
        except ImportError:
            return error(501, "this needs the package prometheus_client")
        body = await asyncio.to_thread(exposition, self._station.newest)  # some 30 ms for 50 vehicles
        return web.Response(body=body, headers={"Content-Type": CONTENT_TYPE})


def _json(value: Struct) -> web.Response:
    return web.Response(body=_encoder.encode(value), content_type="application/json")


async def _body(request: web.Request, type_: type[T]) -> T | web.Response:
    """The body as a value of this type, or the refusal of it."""
    if request.content_type != "application/json":
        return error(415, "expected Content-Type: application/json")
    try:
        return msgspec.json.decode(await request.read(), type=type_)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as problem:
        return error(400, f"the body is no {type_.__name__}: {in_plain_words(problem)}"[:300])


PAGE = Path(__file__).parent / "page"
TYPES = {
    ".html": "text/html",
    ".css": "text/css",
    ".js": "text/javascript",
    ".mjs": "text/javascript",
    ".json": "application/json",
    ".webmanifest": "application/manifest+json",
    ".svg": "image/svg+xml",
    ".png": "image/png",
    ".ico": "image/x-icon",
    ".woff2": "font/woff2",
    ".txt": "text/plain",
}
PRELOADS = b"<!-- preloads -->"  # in index.html
REFERENCE_FORMS, SHAPE_NAMES, LOOKS, PHASE_RULES = (
    b"[/* reference forms */]",
    b"[/* shapes */]",
    b"[/* vehicle looks */]",
    b"[/* phase rules */]",
)  # likewise
ON_LIGHT, ON_DARK = b"/* vehicle looks on light */", b"/* vehicle looks on dark */"  # in css/theme.css
TILE_AGE_S = 86400


@dataclass(frozen=True, slots=True)
class PageFile:
    """A file of the page as it is sent."""

    body: bytes
    content_type: str
    tag: str  # differs where the content does


def page_files(folder: Path = PAGE) -> Mapping[str, PageFile]:
    """The files of the page by their path below it, of known types; read once at the start."""
    files = [file for file in sorted(folder.rglob("*")) if file.is_file() and file.suffix in TYPES]
    bodies = {file.relative_to(folder).as_posix(): file.read_bytes() for file in files}
    index = bodies["index.html"].replace(PRELOADS, _preloads(bodies))
    index = index.replace(SHAPE_NAMES, _encoder.encode(list(SHAPES)))
    index = index.replace(LOOKS, _encoder.encode({"colours": len(COLOURS), "dashes": DASHES}))
    theme = bodies["css/theme.css"].replace(ON_LIGHT, _colours([one.on_light for one in COLOURS]))
    bodies["css/theme.css"] = theme.replace(ON_DARK, _colours([one.on_dark for one in COLOURS]))
    index = index.replace(PHASE_RULES, _encoder.encode(phase_rules()))
    bodies["index.html"] = index.replace(REFERENCE_FORMS, _encoder.encode(reference_forms()))
    return {path: PageFile(body, TYPES[Path(path).suffix], sha256(body).hexdigest()) for path, body in bodies.items()}


def _colours(colours: Sequence[str]) -> bytes:
    """The colours of the vehicles in the style sheet, each with that of text on it."""
    lines = (f"--vehicle-{n}: {one};\n  --on-vehicle-{n}: {ink_on(one)};" for n, one in enumerate(colours, start=1))
    return "\n  ".join(lines).encode()


def phase_rules() -> dict[str, dict[str, Any]]:
    """Of each phase command: the phases that allow it, and whether that is on the ground. The page's `arm` prepares first."""
    allowed = {name: rule.allowed for name, rule in RULES.items()}
    allowed[CommandName.ARM] |= allowed.pop(CommandName.PREPARE)
    return {
        str(name): {"phases": sorted(phases), "on_ground": RULES[name].on_ground} for name, phases in allowed.items()
    }


def _preloads(paths: Iterable[str]) -> bytes:
    """The browser asks for all modules at once; without this it finds the imports of a module when it has loaded that one."""
    return "".join(f'<link rel="modulepreload" href="{path}">' for path in paths if path.endswith(".js")).encode()


async def page_file(request: web.Request, files: Mapping[str, PageFile]) -> web.StreamResponse:
    """A file of the page; / is index.html."""
    file = files.get(request.match_info.get("path", "") or "index.html")
    if file is None:
        return error(404, f"{request.path[:200]}: no such file of the page")
    if any(known.value == file.tag for known in request.if_none_match or ()):
        return web.Response(status=304)
    charset = "utf-8" if file.content_type.startswith("text/") else None
    response = web.Response(body=file.body, content_type=file.content_type, charset=charset)
    response.headers["Cache-Control"] = "no-cache"
    response.etag = file.tag
    return response


async def tile(request: web.Request, tiles: Tiles | None) -> web.StreamResponse:
    """A map tile. What its file has decides of the type, not the name in the address."""
    z, x, y = (int(request.match_info[name]) for name in ("z", "x", "y"))
    if tiles is None or z > DEEPEST_ZOOM or x >= 1 << z or y >= 1 << z:
        return error(404, "no such tile")
    image = await asyncio.to_thread(tiles.read, z, x, y)  # a slow disk delays no snapshot
    kind = content_type(image) if image else None
    if kind is None:
        return error(404, "no such tile")
    return web.Response(body=image, content_type=kind, headers={"Cache-Control": f"max-age={TILE_AGE_S}"})


TOKEN_BYTES = 24
CLOSE_WITHIN_S = 0.5
LISTEN = re.compile(r"(?:(\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):)?(\d{1,5})")
LISTEN_WORDS = "ADDRESS:PORT, like 127.0.0.1:8600; port 0 chooses a free one"
_log = logging.getLogger(__name__)
_log.addFilter(lambda record: not (record.exc_info and isinstance(record.exc_info[1], HttpProcessingError)))
"""For aiohttp. Who sends what is no HTTP gets the reason as an answer; the operator's terminal needs none of it."""


@dataclass(frozen=True, slots=True)
class Address:
    host: str
    port: int

    def __str__(self) -> str:
        return f"{self.host}:{self.port}"


def listen_address(text: str) -> Address:
    """Raises ValueError with what was expected."""
    found = LISTEN.fullmatch(text)
    if not found or int(found[2]) > 65535:
        raise ValueError(f"{quoted(text)}: expected {LISTEN_WORDS}")
    return Address(found[1] or "127.0.0.1", int(found[2]))


def serve(
    station: Station,
    commander: Commander | None,
    address: Address,
    tiles: Tiles | None = None,
    logs: GroundLogs | None = None,
) -> None:
    """Until Ctrl-C or SIGTERM. Raises MonitorError."""
    asyncio.run(_serve(station, commander, address, tiles, logs))


async def _serve(
    station: Station, commander: Commander | None, address: Address, tiles: Tiles | None, logs: GroundLogs | None
) -> None:
    token = secrets.token_urlsafe(TOKEN_BYTES) if commander else ""
    site = Site(station, commander, token, tiles, logs)
    listening = _listening(address)
    runner = web.AppRunner(
        site.app(address.host), handle_signals=False, access_log=None, logger=_log, shutdown_timeout=CLOSE_WITHIN_S
    )
    await runner.setup()
    accepting = await site.connections.accept(runner, listening)
    try:
        port = listening.getsockname()[1]
        print(f"{url(address.host, port)}{'#token=' + token if token else ''}", flush=True)
        for line in warnings(address.host, commander is not None):
            print(line, file=sys.stderr, flush=True)
        await _until_stopped(station.run())
    finally:
        accepting.close()
        await site.clients.close()
        await runner.cleanup()


async def _until_stopped(job: Coroutine[Any, Any, None]) -> None:
    """Run the job until SIGINT or SIGTERM. An error in it is raised."""
    stop, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    running, waiting = asyncio.create_task(job), asyncio.create_task(stop.wait())
    await asyncio.wait([running, waiting], return_when=asyncio.FIRST_COMPLETED)
    for task in (running, waiting):
        task.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await running


def _listening(address: Address) -> socket.socket:
    """A bound socket. Raises MonitorError."""
    host = address.host.strip("[]")
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, address.port, type=socket.SOCK_STREAM)[0]
        listening = socket.socket(family, kind, protocol)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(where)
        except OSError:
            listening.close()
            raise
    except OSError as error:
        raise MonitorError(f"--listen {address}: {_reason(error)}") from error
    return listening


def _reason(error: OSError) -> str:
    if isinstance(error, socket.gaierror):
        return "unknown host; expected an address of this machine, like 127.0.0.1"
    match error.errno:
        case errno.EADDRINUSE:
            return "the port is in use; choose another one, or port 0 for any free one"
        case errno.EADDRNOTAVAIL:
            return "this machine has no such address; expected one of its own, like 127.0.0.1, or 0.0.0.0 for all"
        case errno.EACCES:
            return "not permitted; choose a port above 1023"
    return error.strerror or str(error)


def url(host: str, port: int) -> str:
    """For a browser on this machine; of 0.0.0.0 and :: by its name in the network."""
    shown = socket.gethostname() if host in ("0.0.0.0", "[::]") else host
    return f"http://{shown}:{port}/"


def warnings(host: str, may_control: bool) -> list[str]:
    """One line where others reach the server."""
    if is_loopback(host):
        return []
    what = (
        "see this fleet, and command it with the token, which they can read on the way"
        if may_control
        else "see this fleet"
    )
    return [f"warning: all who reach {host} over the network can {what} (HTTP without encryption)"]
