"""The addresses of the server and what each answers. docs/api.md has them for people."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import TypeVar

import msgspec
from aiohttp import web

from companion.monitor.api import CommandRequest, ControlView
from companion.monitor.control.commander import Commander
from companion.monitor.server.access import add_headers, error, guard, has_token
from companion.monitor.server.clients import MOST_CLIENTS, Clients
from companion.monitor.server.connections import Connections
from companion.monitor.server.files import page_file, page_files, tile
from companion.monitor.station import Station

LONGEST_BODY = 64 * 1024  # bytes: a formation of 250 vehicles has 15 kB
VIEW_ONLY = "this server shows and does not command; start it with: companion monitor --control"
WRONG_TOKEN = "the token is missing or wrong; open the URL that companion monitor --control printed"

T = TypeVar("T")
_encoder = msgspec.json.Encoder()


class Site:
    """The handlers. `commander` is None without --control; then `token` is not used."""

    def __init__(self, station: Station, commander: Commander | None, token: str, tiles: Path | None) -> None:
        self._station = station
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
                web.get(f"{api}/fleets/{{name}}", self._fleet),
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
        if not web.WebSocketResponse().can_prepare(request):
            return error(426, "expected a WebSocket; GET /api/v1/snapshot gives one snapshot")
        if self.clients.is_full:
            return error(503, f"{MOST_CLIENTS} clients are connected already; close one of them")
        return await self.clients.serve(request, self._encoded, self._station.act)

    async def _snapshot(self, _request: web.Request) -> web.StreamResponse:
        return _json(self._station.newest)

    async def _history(self, _request: web.Request) -> web.StreamResponse:
        return _json(self._station.history())

    async def _fleet(self, request: web.Request) -> web.StreamResponse:
        view = self._station.fleet_map(request.match_info["name"])
        if view is None:
            known = ", ".join(self._station.fleet_names) or "none; give one with --fleet-file"
            return error(404, f"this server has no such fleet file; it has: {known}")
        return _json(msgspec.structs.replace(view, tiles=self._tiles is not None))

    async def _acknowledge(self, request: web.Request) -> web.StreamResponse:
        if self._commander and not has_token(request, self._token):
            return error(403, WRONG_TOKEN)
        alarm = self._station.acknowledge(int(request.match_info["id"]))
        return error(404, "no such alarm; it has ended") if alarm is None else _json(alarm)

    async def _control(self, request: web.Request) -> web.StreamResponse:
        return _json(ControlView(self._commander is not None and has_token(request, self._token)))

    async def _command(self, request: web.Request) -> web.StreamResponse:
        if self._commander is None or not has_token(request, self._token):
            return error(403, WRONG_TOKEN if self._commander else VIEW_ONLY)
        wanted = await _body(request, CommandRequest)
        if isinstance(wanted, web.Response):
            return wanted
        return _json(await self._commander.send(wanted))

    async def _preview(self, request: web.Request) -> web.StreamResponse:
        if self._commander is None or not has_token(request, self._token):
            return error(403, WRONG_TOKEN if self._commander else VIEW_ONLY)
        wanted = await _body(request, CommandRequest)
        if isinstance(wanted, web.Response):
            return wanted
        return _json(await self._commander.preview(wanted))

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


def _json(value: msgspec.Struct) -> web.Response:
    return web.Response(body=_encoder.encode(value), content_type="application/json")


async def _body(request: web.Request, type_: type[T]) -> T | web.Response:
    """The body as a value of this type, or the refusal of it."""
    if request.content_type != "application/json":
        return error(415, "expected Content-Type: application/json")
    try:
        return msgspec.json.decode(await request.read(), type=type_)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as problem:
        return error(400, f"the body is no {type_.__name__}: {problem}"[:300])
