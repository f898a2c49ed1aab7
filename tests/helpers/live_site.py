"""The real server of the live page: in the event loop of the test or as a process, and snapshots for it."""

from __future__ import annotations

import asyncio
import http.client
import json
import re
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, closing, contextmanager, suppress
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any

from aiohttp import ClientSession, web
from msgspec.structs import replace

from companion.config.fleet import FleetConfig
from companion.ground.session import FleetSession
from companion.monitor.api import (
    TOKEN_HEADER,
    AlarmView,
    BatteryView,
    FlagView,
    FleetView,
    NearestView,
    Snapshot,
    TimingView,
    VehicleView,
)
from companion.monitor.commander import Commander
from companion.monitor.ground_logs import GroundLogs
from companion.monitor.server import Site
from companion.monitor.sources import LiveSource, ReplaySource, Source
from companion.monitor.station import Station
from companion.monitor.tiles import open_tiles
from companion.types.status import NetworkState
from companion.types.values import ZERO3
from ground_fleet import LinkedVehicles
from tests.bench.monitor_load import SteadyFleet, steady_fleet

VEHICLE = VehicleView(
    fleet="platoon",
    vehicle_id=1,
    silent=False,
    age_s=0.04,
    data_age_s=0.06,
    report_rate_hz=10.0,
    phase="formation",
    role="leader",
    mode="OFFBOARD",
    armed=True,
    landed="IN_AIR",
    position_enu_m=(1.0, 2.0, 2.5),
    velocity_enu_m_s=(3.0, 4.0, 0.0),
    position_error_m=(0.4, 0.7),
    battery_percent=87.0,
    law="weighted",
    prc=1,
    epoch=0,
    leader_id=1,
    leader_beacon_age_s=0.1,
    neighbours=(),
    peers=(2, 3),
    slot_position_enu_m=ZERO3,
    slot_offset_enu_m=ZERO3,
    error_to_slot_m=0.13,
    reference_enu_m=ZERO3,
    formation="1",
    reference="3",
    holder="anna@ground",
    flags=(FlagView("TICK_LATE", "warning", "late", "warn", "end other programs"),),
    lacks=(),
    refuses_return=None,
    nearest=NearestView("2", 1.5, 1.2, 0.0),
    hover_thrust_norm=0.5,
    wind_acceleration_enu_m_s2=ZERO3,
    timing=TimingView(50.0, 3, 0.2, 0.9, 4.0, 0.6, 2.1, 14.0, 49.0),
    network=NetworkState(),
    rejected=7,
    last_event=None,
)
FLEET = FleetView(
    name="platoon",
    vehicle_ids=(1, 2),
    missing_ids=(),
    leader_ids=(1,),
    smallest_separation_m=1.5,
    smallest_separation_pair=(1, 2),
    smallest_separation_unheard=False,
    separation_trend_m_s=-0.1,
    lambda_min=None,
    settling_s=None,
    link_margin_m=None,
    link_margin_pair=None,
    data_age_worst_s=0.06,
    battery_lowest=BatteryView(2, 71.0, 9.5),
    position_error_worst_m=0.04,
    wind_acceleration_enu_m_s2=None,
)
ALARM = AlarmView(
    id=1,
    fleet="platoon",
    vehicle_id=2,
    code="SILENT",
    severity="critical",
    text="",
    advice="",
    since_s=0.0,
    until_s=None,
    acknowledged=False,
    first_s=0.0,
)


def monitored_vehicle(vehicle_id: int, **changes: object) -> VehicleView:
    return replace(VEHICLE, vehicle_id=vehicle_id, **changes)  # type: ignore[arg-type]


def monitored_snapshot(*vehicles: VehicleView, **changes: object) -> Snapshot:
    plain = Snapshot(
        number=1,
        time_s=1_700_000_000.0,
        commands="",
        operator="anna@ground",
        connected=(),
        unreachable=("tcp/127.0.0.1:7448",),
        vehicles=vehicles,
        fleets=(FLEET,),
        alarms=(ALARM,),
    )
    return replace(plain, **changes)  # type: ignore[arg-type]


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
    source: Source,
    fleet: FleetConfig,
    session: FleetSession | None = None,
    tiles: Path | None = None,
    logs: Path | None = None,
) -> AsyncIterator[Served]:
    """With a session commands are accepted."""
    station = Station(source, {fleet.name: fleet}, "anna@ground", commands=fleet.name if session else "")
    commander = Commander(session, fleet, station.log) if session else None
    site = Site(station, commander, TOKEN, open_tiles(tiles) if tiles else None, GroundLogs(logs))
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


async def until_served(condition: Callable[[], Awaitable[Any]], timeout_s: float = 15.0) -> Any:
    """The first result that is true."""
    async with asyncio.timeout(timeout_s):
        while not (result := await condition()):
            await asyncio.sleep(0.02)
        return result


@contextmanager
def monitor(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The process and the line that it printed."""
    process = subprocess.Popen(
        [sys.executable, "-m", "companion", "monitor", "--listen", "127.0.0.1:0", *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout
    try:
        yield process, process.stdout.readline().strip()
    finally:
        process.kill()
        process.communicate()


def get(url: str, path: str, method: str = "GET", body: str = "", **headers: str) -> tuple[int, str]:
    found = re.match(r"http://([\d.]+):(\d+)/", url)
    assert found, url
    with closing(http.client.HTTPConnection(found[1], int(found[2]), timeout=20)) as connection:
        connection.request(method, path, body, headers)
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


def snapshot(url: str) -> dict[str, list[dict[str, object]]]:
    decoded: dict[str, list[dict[str, object]]] = json.loads(get(url, "/api/v1/snapshot")[1])
    return decoded
