"""The server of the live page on a free port of this machine, with the real Site and Station in the test's event loop."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from aiohttp import ClientSession, web

from companion.config.fleet import FleetConfig
from companion.ground.session import FleetSession
from companion.monitor.api import TOKEN_HEADER
from companion.monitor.commander import Commander
from companion.monitor.server import Site
from companion.monitor.sources import LiveSource, ReplaySource, Source
from companion.monitor.station import Station
from linked_vehicles import LinkedVehicles
from tests.bench.monitor_load import SteadyFleet, steady_fleet

TOKEN = "a-token-of-this-test"


@dataclass
class Served:
    station: Station
    site: Site
    url: str
    http: ClientSession

    async def get(self, path: str, **headers: str) -> tuple[int, Any]:
        async with self.http.get(self.url + path, headers=headers) as response:
            return response.status, await response.json()

    async def post(self, path: str, content: Any, **headers: str) -> tuple[int, Any]:
        async with self.http.post(self.url + path, json=content, headers=headers) as response:
            return response.status, await response.json()

    async def raw(self, lines: list[str], last: bytes) -> tuple[int, Any]:
        """A request with these lines and Host, as no client would send it."""
        address = self.url.removeprefix("http://")
        reader, writer = await asyncio.open_connection(*address.split(":"))
        writer.write("\r\n".join([*lines, f"Host: {address}", "Connection: close", ""]).encode() + last + b"\r\n\r\n")
        head, _, body = (await reader.read()).partition(b"\r\n\r\n")
        writer.close()
        return int(head.split()[1]), json.loads(body)

    async def command(self, name: str, content: Any = None, ids: tuple[int, ...] = ()) -> Any:
        wanted = {"fleet": "load", "name": name, "vehicle_ids": ids, "content": content or {}}
        status, result = await self.post("/api/v1/commands", wanted, **{TOKEN_HEADER: TOKEN})
        assert status == 200, result
        return result


def recorded(seconds: float = 20.0, lost_after_s: float = inf) -> tuple[SteadyFleet, ReplaySource]:
    """Three vehicles in formation, recorded ten times a second; vehicle 3 is lost."""
    load = steady_fleet("load", 3)
    times = [step / 10 for step in range(int(seconds * 10))]
    reports = [(1.8e9 + t, load.report(i, t)) for t in times for i in load.vehicle_ids if i < 3 or t < lost_after_s]
    return load, ReplaySource(reports)


@asynccontextmanager
async def served(
    source: Source, fleet: FleetConfig, session: FleetSession | None = None, tiles: Path | None = None
) -> AsyncIterator[Served]:
    """With a session commands are accepted."""
    station = Station(source, {fleet.name: fleet}, "anna@ground", may_control=session is not None)
    commander = Commander(session, fleet, station.log) if session else None
    site = Site(station, commander, TOKEN, tiles)
    listening = socket.create_server(("127.0.0.1", 0))
    runner = web.AppRunner(site.app("127.0.0.1"), handle_signals=False, access_log=None, shutdown_timeout=0.5)
    await runner.setup()
    running = asyncio.create_task(station.run())
    accepting = await site.connections.accept(runner, listening)
    try:
        port = listening.getsockname()[1]
        async with ClientSession() as http:
            yield Served(station, site, f"http://127.0.0.1:{port}", http)
    finally:
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running
        accepting.close()
        await site.clients.close()
        await runner.cleanup()
        if commander:
            commander.close()


@asynccontextmanager
async def served_live(vehicles: LinkedVehicles, control: bool = True) -> AsyncIterator[Served]:
    """With a real session to the vehicles."""
    fleet = vehicles.load.fleet
    with FleetSession(fleet.name, vehicles.endpoints, "anna@ground") as session:
        async with served(LiveSource(session, vehicles.endpoints), fleet, session if control else None) as one:
            yield one


async def until_true(condition: Callable[[], Awaitable[Any]], timeout_s: float = 15.0) -> Any:
    """The first result that is true."""
    async with asyncio.timeout(timeout_s):
        while not (result := await condition()):
            await asyncio.sleep(0.02)
        return result
