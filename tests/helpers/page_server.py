"""A server of the live page whose fleet a test changes, and waiting for what the page shows: for tests in a browser."""

from __future__ import annotations

import asyncio
import threading
import time
from collections import deque
from collections.abc import Callable
from math import ceil, cos, dist, pi, radians, sin, sqrt
from typing import TYPE_CHECKING, Any

import msgspec
from aiohttp import WSMsgType, web
from msgspec import structs

from companion.geometry.curves import figure_8
from companion.geometry.formations import SHAPES
from companion.geometry.formations import slots_of as shape_slots
from companion.monitor.api import (
    LIVE_PROTOCOL,
    AlarmView,
    AnswerView,
    BatteryView,
    CommandRequest,
    CommandResult,
    ControlView,
    EventView,
    FleetFileView,
    FleetView,
    FlightView,
    History,
    HistoryPoint,
    HistorySample,
    LogsView,
    MemberView,
    NearestView,
    NeighbourView,
    ObstacleView,
    PathView,
    Preview,
    ReplayView,
    Severity,
    Snapshot,
    TimingView,
    VehicleView,
)
from companion.monitor.events import ENDED, NOTHING_GIVEN, Given, Happening, Kind, event_view
from companion.monitor.server import page_file, page_files
from companion.types.status import NetworkState
from companion.types.values import Vector3

if TYPE_CHECKING:
    from playwright.sync_api import Page


SPACING_M = 4.0
ALTITUDE_M = 5.0
SEPARATION_M = 2.5
WARNING = "LOOKS_LIKE_DEGREES: reference.point_enu_m: [47.397755, 8.545594, 3.0] looks like latitude and longitude"


def slots_of(count: int) -> list[Vector3]:
    """A diamond of four, a grid of more."""
    if count == 4:
        return [(3.0, 0.0, 0.0), (0.0, 3.0, 0.0), (0.0, -3.0, 0.0), (-3.0, 0.0, 0.0)]
    columns = ceil(sqrt(count))
    middle = (columns - 1) / 2.0
    return [((middle - i // columns) * SPACING_M, (middle - i % columns) * SPACING_M, 0.0) for i in range(count)]


def reference_at(time_s: float, count: int) -> tuple[Vector3, Vector3]:
    """Position and velocity."""
    scale = max(1.0, sqrt(count) / 3.0)
    (x, y, _), velocity, _ = figure_8(time_s, 24.0 * scale, 12.0 * scale, 60.0 * scale, 5.0)
    return (x, y, ALTITUDE_M), velocity


def vehicles_at(time_s: float, count: int, fleet: str = "ring") -> list[VehicleView]:
    """All in formation; vehicle 1 leads."""
    centre, velocity = reference_at(time_s, count)
    slots = slots_of(count)
    positions = [_beside(slot, centre, time_s, i) for i, slot in enumerate(slots)]
    return [_page_vehicle(i, fleet, slots, positions, centre, velocity, time_s) for i in range(count)]


def _beside(slot: Vector3, centre: Vector3, time_s: float, i: int) -> Vector3:
    """The slot with a small wandering error."""
    error_m = 0.12 + 0.08 * sin(0.3 * time_s + i)
    angle = 0.2 * time_s + 2.0 * i
    x, y, z = (s + c for s, c in zip(slot, centre, strict=True))
    return (x + error_m * cos(angle), y + error_m * sin(angle), z + 0.15 * sin(0.15 * time_s + i))


def _page_vehicle(
    i: int,
    fleet: str,
    slots: list[Vector3],
    positions: list[Vector3],
    centre: Vector3,
    velocity: Vector3,
    time_s: float,
) -> VehicleView:
    position = positions[i]
    slot = tuple(s + c for s, c in zip(slots[i], centre, strict=True))
    others = sorted((dist(position, other), j) for j, other in enumerate(positions) if j != i)
    near = [j for distance_m, j in others[:4] if distance_m < 1.5 * SPACING_M]
    return VehicleView(
        fleet=fleet,
        vehicle_id=i + 1,
        silent=False,
        age_s=0.05,
        data_age_s=0.08 + 0.02 * sin(time_s + i),
        report_rate_hz=10.0,
        phase="formation",
        role="follower" if i else "leader",
        mode="OFFBOARD",
        armed=True,
        landed="in_air",
        position_enu_m=position,
        velocity_enu_m_s=velocity,
        position_error_m=(0.21, 0.34),
        battery_percent=92.0 - 0.02 * time_s - 1.5 * (i % 7),
        law="weighted",
        prc=i + 1 if i < 3 else 3,
        epoch=1,
        leader_id=1,
        leader_beacon_age_s=0.06,
        neighbours=tuple(NeighbourView(j + 1, 1.0 / max(1, len(near)) * (1.4 if j < i else 0.6), 0.04) for j in near),
        peers=tuple(j + 1 for j in range(len(slots)) if j != i),
        slot_position_enu_m=slot,
        slot_offset_enu_m=slots[i],
        error_to_slot_m=dist(position, slot),
        reference_enu_m=None if i else centre,
        formation="2",
        reference="figure 8",
        holder="ground-anna",
        flags=(),
        lacks=(),
        refuses_return=None,
        nearest=NearestView(f"vehicle {others[0][1] + 1}", others[0][0], 2.7, 0.0) if others else None,
        hover_thrust_norm=0.52,
        wind_acceleration_enu_m_s2=(0.3, -0.1, 0.0),
        timing=TimingView(50.0, 0, 0.2, 0.9 + 0.4 * abs(sin(0.4 * time_s + i)), 3.1, 6.0, 11.0, 14.0, 61.0),
        network=NetworkState(security="identity", admission=3),
        rejected=0,
        last_event="FORMATION_CHANGED: formation 2 is flown",
    )


def page_fleet_of(vehicles: list[VehicleView], name: str = "ring") -> FleetView:
    seen = [vehicle for vehicle in vehicles if not vehicle.silent]
    pairs = [
        (dist(a.position_enu_m, b.position_enu_m), (a.vehicle_id, b.vehicle_id))
        for a in seen
        for b in seen
        if a is not b
    ]
    distance_m, pair = min(pairs) if pairs else (None, None)
    return FleetView(
        name=name,
        vehicle_ids=tuple(vehicle.vehicle_id for vehicle in vehicles),
        missing_ids=(),
        leader_ids=(1,),
        smallest_separation_m=distance_m,
        smallest_separation_pair=pair,
        smallest_separation_unheard=False,
        separation_trend_m_s=-0.04,
        lambda_min=0.382,
        settling_s=6.4,
        link_margin_m=11.5,
        link_margin_pair=(3, 4),
        data_age_worst_s=0.11,
        battery_lowest=min(
            (BatteryView(v.vehicle_id, v.battery_percent, 7.4) for v in seen if v.battery_percent is not None),
            key=lambda battery: battery.percent,
            default=None,
        ),
        position_error_worst_m=0.31,
        wind_acceleration_enu_m_s2=(0.21, -0.2, 0.0),
    )


def fleet_file(count: int, name: str = "ring") -> FleetFileView:
    reach_m = 22.0 * max(1.0, sqrt(count) / 3.0)

    def at(*corners: tuple[float, float]) -> tuple[tuple[float, float], ...]:
        return tuple((reach_m * x, reach_m * y) for x, y in corners)

    outline = at((-1.0, -1.0), (1.0, -1.0), (1.0, 0.6), (0.4, 1.0), (-1.0, 1.0))
    angles = [i * pi / 12 for i in range(24)]
    mast = tuple((reach_m * 0.75 + cos(angle), reach_m * 0.45 + sin(angle)) for angle in angles)
    shed = at((-0.9, -0.9), (-0.6, -0.9), (-0.6, -0.7), (-0.9, -0.7))
    slots = slots_of(count)
    return FleetFileView(
        name=name,
        law="weighted",
        origin=(47.397742, 8.545594, 488.0),
        members=tuple(MemberView(i + 1, "follower" if i else "leader", i < 3, slot) for i, slot in enumerate(slots)),
        edges=(),
        range_m=6.0,
        separation_m=SEPARATION_M,
        fence_outline_enu_m=outline,
        fence_floor_m=-5.0,
        fence_ceiling_m=30.0,
        clearance_m=0.5,
        obstacles=(ObstacleView(mast, -10000.0, 18.0), ObstacleView(shed, 0.0, 4.0)),
        homes_enu_m={i + 1: slot for i, slot in enumerate(slots)},
        reference_enu_m=tuple(reference_at(5.0 + step, count)[0] for step in range(61)),
    )


FILES = page_files()
TOKEN = "a-token-of-this-test"  # until a test changes that of its server
POLICY = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; base-uri 'none'"
Change = Callable[[list[VehicleView]], list[VehicleView]]
ANSWER_MS = 31.0
HISTORY_POINTS = 60


class PageServer:
    """Serves in a thread, from `with` to its end. A test sets the public attributes; they hold from the next snapshot on."""

    def __init__(self, count: int = 4, *, may_control: bool = False, port: int = 0) -> None:
        self.count = count
        self.may_control = may_control
        self.token = TOKEN
        self.port = port
        self.change: Change = lambda vehicles: vehicles
        self.unreachable: tuple[str, ...] = ()  # with these no vehicle reports
        self.alarms: list[AlarmView] = []
        self.events: list[EventView] = []  # taken by the next snapshot
        self.flight = FlightView((), {})  # of a replay
        self.logs = LogsView(False, ())
        self.replay: ReplayView | None = None
        self.refuse: dict[int, str] = {}  # by vehicle, the reason
        self.most_speed_m_s = 100.0  # of a reference
        self.no_place = ""  # why a WebSocket is refused
        self.drops_protocols = False  # as a proxy that does not know them
        self.paused = False  # nothing is sent, but the connection stays
        self.delayed_by = 0  # snapshots that wait on a slow network
        self.skipped = 0  # snapshots that a slow client misses before each
        self.histories = 0  # how often the history was asked for
        self.commands: list[CommandRequest] = []
        self.received: list[dict[str, object]] = []  # over the WebSocket
        self.begin_s = time.time() - 180.0
        self.fleet_name = "ring"
        self._number = 0
        self._started = threading.Event()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}/"

    @property
    def control_url(self) -> str:
        return f"{self.url}#token={self.token}"

    def __enter__(self) -> PageServer:
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), daemon=True)
        self._thread.start()
        assert self._started.wait(20.0)
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def stop(self) -> None:
        """As a server that ends: every connection is closed."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(self._ended.set)
            self._thread.join(20.0)

    def alarm(self, vehicle_id: int | None, code: str, severity: Severity = "critical", text: str = "") -> AlarmView:
        alarm = AlarmView(
            id=len(self.alarms) + 1,
            fleet=self.fleet_name,
            vehicle_id=vehicle_id,
            code=code,
            severity=severity,
            text=text or f"{code} of a test",
            advice="look at the vehicle",
            since_s=time.time() - 4.0,
            first_s=time.time() - 4.0,
            until_s=None,
            acknowledged=False,
        )
        self.alarms = [*self.alarms, alarm]
        return alarm

    def event(
        self,
        code: str,
        text: str,
        vehicle_id: int | None = None,
        kind: Kind = "event",
        given: Given = NOTHING_GIVEN,
    ) -> None:
        happening = Happening(time.time(), self.fleet_name, vehicle_id, kind, code, text, given)
        self.events.append(event_view(int(happening.time_s * 1e6), happening))

    def vehicles(self, time_s: float) -> list[VehicleView]:
        return self.change(vehicles_at(time_s - self.begin_s, self.count, self.fleet_name))

    def file(self) -> FleetFileView:
        return fleet_file(self.count, self.fleet_name)

    def snapshot(self) -> Snapshot:
        self._number += 1 + self.skipped
        if self.replay:
            self.replay = structs.replace(self.replay, now_s=self.replay.now_s + 0.1 * self.replay.speed)
        now_s = self.replay.now_s if self.replay else time.time()
        vehicles = self.vehicles(now_s)
        vehicles = [] if self.unreachable else vehicles
        fleets: list[FleetView] = [page_fleet_of(vehicles, self.fleet_name)] if vehicles else []
        events, self.events = tuple(self.events), []
        return Snapshot(
            number=self._number,
            time_s=now_s,
            commands=self.fleet_name if self.may_control else "",
            operator="ground-anna",
            connected=tuple(f"tcp/192.168.1.{10 + i}:7447" for i in range(len(vehicles))),
            unreachable=self.unreachable,
            vehicles=tuple(vehicles),
            fleets=tuple(fleets),
            alarms=tuple(self.alarms),
            events=events,
            replay=self.replay,
        )

    async def _serve(self) -> None:
        self._loop, self._ended = asyncio.get_running_loop(), asyncio.Event()
        app = web.Application(middlewares=[_policy])
        app.add_routes(
            [
                web.get("/api/v1/live", self._live),
                web.get("/api/v1/history", self._history),
                web.get("/api/v1/flight", self._flight),
                web.get("/api/v1/logs", self._logs),
                web.get("/api/v1/fleets/{name}", self._fleet),
                web.get("/api/v1/control", self._control),
                web.post("/api/v1/commands", self._command),
                web.post("/api/v1/preview", self._preview),
                web.post("/api/v1/alarms/{id}/acknowledge", self._acknowledge),
                web.get("/{path:.*}", _page_file),
            ]
        )
        runner = web.AppRunner(app, shutdown_timeout=0.1)
        await runner.setup()
        site = web.TCPSite(runner, "127.0.0.1", self.port, reuse_address=True)
        await site.start()
        self.port = runner.addresses[0][1]
        self._started.set()
        await self._ended.wait()
        await runner.cleanup()

    async def _live(self, request: web.Request) -> web.StreamResponse:
        if self.no_place:
            return _json({"error": self.no_place}, status=503)
        socket = web.WebSocketResponse(protocols=() if self.drops_protocols else (LIVE_PROTOCOL,))
        await socket.prepare(request)
        sender = asyncio.ensure_future(self._send(socket))
        ended = asyncio.ensure_future(self._ended.wait())
        reader = asyncio.ensure_future(self._read(socket))
        await asyncio.wait([sender, ended, reader], return_when=asyncio.FIRST_COMPLETED)
        for task in (sender, ended, reader):
            task.cancel()
        await socket.close()
        return socket

    async def _send(self, socket: web.WebSocketResponse) -> None:
        waiting: deque[str] = deque()
        while True:
            if not self.paused:
                waiting.append(msgspec.json.encode(self.snapshot()).decode())
                if len(waiting) > self.delayed_by:
                    await socket.send_str(waiting.popleft())
            await asyncio.sleep(0.1)

    async def _read(self, socket: web.WebSocketResponse) -> None:
        async for message in socket:
            if message.type is WSMsgType.TEXT:
                self._act(message.json())

    def _act(self, message: dict[str, Any]) -> None:
        self.received.append(message)
        if self.replay and message["type"] == "seek":
            self.replay = structs.replace(self.replay, now_s=message["time_s"])
        elif self.replay:
            self.replay = structs.replace(self.replay, speed=message["speed"])

    async def _flight(self, _: web.Request) -> web.Response:
        return _json(self.flight)

    async def _logs(self, _: web.Request) -> web.Response:
        return _json(self.logs)

    async def _history(self, _: web.Request) -> web.Response:
        self.histories += 1
        end_s = time.time()
        times = [end_s - (HISTORY_POINTS - i) / 2.0 for i in range(HISTORY_POINTS)]
        return _json(History(tuple(_point(time_s, self.vehicles(time_s), self.fleet_name) for time_s in times), ()))

    async def _fleet(self, _: web.Request) -> web.Response:
        return _json(self.file())

    async def _control(self, request: web.Request) -> web.Response:
        return _json(ControlView(self.may_control and request.headers.get("X-Companion-Token") == self.token))

    async def _command(self, request: web.Request) -> web.Response:
        if request.headers.get("X-Companion-Token") != self.token:
            return _json({"error": "the token is missing or wrong"}, status=403)
        command = msgspec.json.decode(await request.read(), type=CommandRequest)
        self.commands.append(command)
        self.event(f"COMMAND {command.name}", "sent", kind="command")
        ids = command.vehicle_ids or range(1, self.count + 1)
        return _json(CommandResult(command.name, tuple(self._answer(vehicle_id, command.name) for vehicle_id in ids)))

    def _answer(self, vehicle_id: int, name: str) -> AnswerView:
        if reason := self.refuse.get(vehicle_id):
            return AnswerView(vehicle_id, "refused", "COMMAND_REFUSED", reason, ANSWER_MS)
        return AnswerView(vehicle_id, "accepted", "PHASE_CHANGED", f"{name} begins", ANSWER_MS)

    async def _preview(self, request: web.Request) -> web.Response:
        command = msgspec.json.decode(await request.read(), type=CommandRequest)
        if command.name == "reference":
            if command.content.get("max_speed_m_s", 0.0) > self.most_speed_m_s:
                return _json(Preview(refused="too fast", instead={"max_speed_m_s": self.most_speed_m_s}))
            centre = command.content.get("centre_enu_m") or command.content.get("point_enu_m")
            track = (tuple(centre),) if centre else tuple(map(tuple, command.content["points_enu_m"]))
            return _json(Preview(track_enu_m=track, lasts_s=12.0, warning=WARNING))  # type: ignore[arg-type]
        leader, *_ = vehicles = self.vehicles(time.time())
        if given := command.content.get("slots_enu_m"):
            slots = [tuple(given[str(v.vehicle_id)]) for v in vehicles]
        else:
            spacing_m = command.content["spacing_m"]
            if spacing_m < 2.5:
                refused = f"SLOT_TOO_CLOSE: slots {spacing_m} m apart, separation_m is 2.5 m"
                return _json(Preview(refused=refused, instead={"spacing_m": 2.5}))
            if spacing_m > 40.0:
                refused = "vehicles 1, 2, 3, 4: SLOT_OUTSIDE_FENCE: formation: too wide for the fence"
                return _json(Preview(refused=refused, instead={"spacing_m": 40.0}))
            shape = SHAPES[command.content["shape"]]
            slots = shape_slots(shape, self.count, spacing_m, radians(command.content["heading_deg"]))
        x, y, z = leader.reference_enu_m or leader.position_enu_m
        paths = tuple(
            PathView(v.vehicle_id, v.slot_position_enu_m or v.position_enu_m, (x + dx, y + dy, z + dz))
            for v, (dx, dy, dz) in zip(vehicles, slots, strict=True)
        )
        would = tuple(
            AnswerView(v.vehicle_id, "accepted", "CHECK_PASSED", "would be accepted", ANSWER_MS) for v in vehicles
        )
        by_id = {v.vehicle_id: slot for v, slot in zip(vehicles, slots, strict=True)}
        return _json(
            Preview(paths=paths, slots_enu_m=by_id, smallest_separation_m=2.81, lasts_s=6.2, answers=would)  # type: ignore[arg-type]
        )

    async def _acknowledge(self, request: web.Request) -> web.Response:
        if self.may_control and request.headers.get("X-Companion-Token") != self.token:
            return _json({"error": "the token is missing or wrong"}, status=403)
        number = int(request.match_info["id"])
        self.alarms = [structs.replace(a, acknowledged=True) if a.id == number else a for a in self.alarms]
        return _json({})


def _point(time_s: float, vehicles: list[VehicleView], fleet: str) -> HistoryPoint:
    samples = []
    for vehicle in vehicles:
        nearest_m = vehicle.nearest.distance_m if vehicle.nearest else None
        altitude_m, late_ms = vehicle.position_enu_m[2], vehicle.timing.late_p99_ms
        values = (altitude_m, vehicle.error_to_slot_m, vehicle.battery_percent, late_ms, nearest_m)
        samples.append(HistorySample(vehicle.vehicle_id, *values))
    return HistoryPoint(time_s, fleet, page_fleet_of(vehicles).smallest_separation_m, tuple(samples))


@web.middleware
async def _policy(request: web.Request, handler: Callable[[web.Request], object]) -> web.StreamResponse:
    response: web.StreamResponse = await handler(request)  # type: ignore[misc]
    response.headers["Content-Security-Policy"] = POLICY
    return response


async def _page_file(request: web.Request) -> web.StreamResponse:
    return await page_file(request, FILES)


def _json(value: object, status: int = 200) -> web.Response:
    return web.Response(body=msgspec.json.encode(value), content_type="application/json", status=status)


ANNA = "anna@ground"


def flown(begin_s: float, fleet: str = "ring") -> FlightView:
    """A hold that vehicle 2 refuses, another formation, another leader, an alarm, a landing."""

    def at(offset_s: float, kind: Kind, i: int | None, code: str, text: str, given: Given = NOTHING_GIVEN) -> Happening:
        return Happening(begin_s + offset_s, fleet, i, kind, code, text, given)

    happened = []
    for i in (1, 2):
        given = Given(ANNA, f"{ANNA}/{i}/7")
        happened.append(at(50.0 + i / 100.0, "command", i, "hold", f"{ANNA}: hold", given))
        outcome, reason = ("accepted", "holds") if i == 1 else ("refused", "it is not armed")
        answer = given.answered(outcome)
        happened.append(at(50.1 + i / 100.0, "answer", i, "CODE", f"{outcome} for {ANNA}: {reason}", answer))
    happened += [at(100.0 + i / 100.0, "formation", i, "FORMATION_CHANGED", "formation 1 -> 2") for i in (1, 2, 3, 4)]
    happened += [
        at(150.0, "leader", 2, "ROLE_CHANGED", "follower -> leader in epoch 2"),
        at(200.0, "alarm", 3, "BATTERY_LOW", "battery below 25 %"),
        at(210.0, "alarm", 3, "BATTERY_LOW", "ended after 10.0 s", Given(outcome=ENDED)),
        at(250.0, "command", 1, "land", f"{ANNA}: land", Given(ANNA, f"{ANNA}/1/8")),
    ]
    events = tuple(event_view(number, happening) for number, happening in enumerate(happened, start=1))
    return FlightView(events, {fleet: (1,)})


PATIENCE_S = 30.0
STEP_MS = 50


def until_shown(page: Page, condition: str | Callable[[], object]) -> None:
    """Until an expression in the page, or a function here, is true. The page goes on meanwhile."""
    end_s = time.monotonic() + PATIENCE_S
    while not (page.evaluate(condition) if isinstance(condition, str) else condition()):
        assert time.monotonic() < end_s, condition
        page.wait_for_timeout(STEP_MS)
