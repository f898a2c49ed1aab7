"""The interface for programs over loopback: a recorded fleet, played again."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from math import inf
from pathlib import Path

import msgspec
import pytest
from yarl import URL

from companion.monitor.api import FleetFileView, FlightView, History, Snapshot
from live_site import Served, recorded, served, until_served


def with_server(work: Callable[[Served], Awaitable[None]], lost_after_s: float = inf) -> None:
    async def run() -> None:
        load, source = recorded(lost_after_s=lost_after_s)
        async with served(source, load.fleet) as server:
            await work(server)

    asyncio.run(run())


def test_every_address_answers_with_its_type() -> None:
    async def work(server: Served) -> None:
        await until_served(lambda: _vehicles(server))
        for path, type_ in (
            ("snapshot", Snapshot),
            ("history", History),
            ("flight", FlightView),
            ("fleets/load", FleetFileView),
        ):
            async with server.http.get(f"{server.url}/api/v1/{path}") as response:
                assert response.content_type == "application/json"
                msgspec.json.decode(await response.read(), type=type_)
        status, answer = await server.get("/api/v1/fleets/other")
        assert (status, "it has: load" in answer["error"]) == (404, True)
        assert (await server.get("/api/v1/nothing"))[0] == 404
        assert (await server.get("/api/v1/live"))[0] == 426

    with_server(work)


async def _vehicles(server: Served) -> list[int]:
    return [v["vehicle_id"] for v in (await server.get("/api/v1/snapshot"))[1]["vehicles"]]


def test_snapshots_come_in_order_with_each_event_once() -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:
            first = await live.receive_json()
            for i in range(5):
                server.station.log("load", 1, "event", "CODE", str(i))
            numbers, texts = [first["number"]], []
            while len(texts) < 5:
                snapshot = await live.receive_json()
                numbers.append(snapshot["number"])
                texts += [event["text"] for event in snapshot["events"] if event["code"] == "CODE"]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        assert texts == ["0", "1", "2", "3", "4"]

    with_server(work)


async def connect_without_reading(server: Served) -> asyncio.StreamWriter:
    """A client of the snapshots that reads nothing after the answer to its upgrade, while this writer is kept."""
    port = URL(server.url).port
    reader, writer = await asyncio.open_connection("127.0.0.1", port, limit=1024)
    writer.write(
        f"GET /api/v1/live HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\n\r\n".encode()
    )
    assert (await reader.readline()).startswith(b"HTTP/1.1 101")
    return writer


def test_a_client_that_does_not_read_delays_no_other() -> None:
    async def work(server: Served) -> None:
        slow = await connect_without_reading(server)
        large = b'"' + b"x" * 8_000_000 + b'"'  # more than the buffers of the connection hold
        async with server.http.ws_connect(f"{server.url}/api/v1/live", max_msg_size=0) as quick:
            server.site.clients.publish(large)
            numbers = [s["number"] for s in [await quick.receive_json() for _ in range(20)] if isinstance(s, dict)]
            assert numbers == sorted(set(numbers))
            assert len(numbers) >= 18
        slow.transport.abort()

    with_server(work)


def test_a_client_that_does_not_read_leaves_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("companion.monitor.access.SEND_WITHIN_S", 0.2)

    async def work(server: Served) -> None:
        slow = await connect_without_reading(server)
        server.site.clients.publish(b'"' + b"x" * 8_000_000 + b'"')

        async def left() -> bool:
            return not server.site.clients.count

        await until_served(left, 1.5)  # without the heartbeat, which would come after 15 s
        slow.transport.abort()

    with_server(work)


def test_nothing_is_queued_for_a_client() -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:
            await live.receive()
            for text in (b'"old"', b'"older"', b'"new"'):  # before the client's turn to send comes
                server.site.clients.publish(text)
            received = []
            while "new" not in received:
                received.append(await live.receive_json())
        assert "old" not in received
        assert "older" not in received

    with_server(work)


def test_a_replay_jumps_and_changes_its_speed() -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:

            async def snapshot_where(condition: Callable[[Snapshot], bool]) -> Snapshot:
                async with asyncio.timeout(15.0):
                    while True:
                        snapshot = msgspec.json.decode(await live.receive_str(), type=Snapshot)
                        if condition(snapshot):
                            return snapshot

            await live.send_json({"type": "speed", "speed": 0.0})
            paused = await snapshot_where(lambda s: s.replay is not None and s.replay.speed == 0.0)
            assert paused.replay is not None
            await live.send_json({"type": "seek", "time_s": paused.replay.begin_s + 15.0})
            there = await snapshot_where(lambda s: s.time_s == paused.replay.begin_s + 15.0 and bool(s.vehicles))  # type: ignore[union-attr]
            assert [v.silent for v in there.vehicles] == [False, False, False]
            await live.send_json({"type": "seek", "time_s": paused.replay.begin_s + 5.0})
            back = await snapshot_where(lambda s: s.time_s == paused.replay.begin_s + 5.0 and bool(s.vehicles))  # type: ignore[union-attr]
            assert back.vehicles[0].position_enu_m != there.vehicles[0].position_enu_m
            assert back.alarms == ()

    with_server(work)


def test_an_alarm_is_acknowledged_without_control() -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:
            await live.send_json({"type": "speed", "speed": 20.0})
            await live.receive()
        alarm = await until_served(lambda: _alarm(server))
        assert (alarm["vehicle_id"], alarm["code"]) == (3, "SILENT")
        status, answer = await server.post(f"/api/v1/alarms/{alarm['id']}/acknowledge", {})
        assert (status, answer["acknowledged"]) == (200, True)
        assert (await server.post("/api/v1/alarms/999/acknowledge", {}))[0] == 404

    with_server(work, lost_after_s=5.0)


async def _alarm(server: Served) -> dict[str, object] | None:
    alarms = (await server.get("/api/v1/snapshot"))[1]["alarms"]
    return alarms[0] if alarms else None


@pytest.mark.parametrize("method", ["OPTIONS", "DELETE", "PUT", "PATCH"])
def test_no_other_method_is_answered(method: str) -> None:
    async def work(server: Served) -> None:
        async with server.http.request(method, f"{server.url}/api/v1/commands") as response:
            assert response.status == 405

    with_server(work)


def test_logs_of_the_folder_are_listed_and_given_by_their_id_alone(tmp_path: Path) -> None:
    folder = tmp_path / "flights"
    (folder / "inside").mkdir(parents=True)
    names = (
        "vehicle_3_0042_001.mcap",
        "vehicle_3_0042_001.tlog",
        "inside/vehicle-2_2026-05-03_log-7.ulg",
        "ground_0007_001.mcap",
    )
    for name in names:
        (folder / name).write_bytes(name.encode() * 1000)
    secret = tmp_path / "vehicle_1_0001_001.mcap"
    secret.write_bytes(b"secret")
    (folder / "fleet.yaml").write_text("no log")
    (folder / "vehicle_1_0001_001.mcap").symlink_to(secret)

    async def work(server: Served) -> None:
        _, listed = await server.get("/api/v1/logs")
        assert {(one["name"], one["vehicle_id"], one["kind"]) for one in listed["files"]} == {
            ("vehicle_3_0042_001.mcap", 3, "recording"),
            ("vehicle_3_0042_001.tlog", 3, "MAVLink"),
            ("vehicle-2_2026-05-03_log-7.ulg", 2, "autopilot"),
            ("ground_0007_001.mcap", None, "recording"),
        }
        for one in listed["files"]:
            async with server.http.get(f"{server.url}/api/v1/logs/{one['id']}") as response:
                assert (await response.read()).count(one["name"].encode()) == 1000
                assert response.headers["Content-Disposition"] == f'attachment; filename="{one["name"]}"'
        for other in ("0" * 16, "fleet.yaml", "..%2fvehicle_1_0001_001.mcap", "../vehicle_1_0001_001.mcap", "%2e%2e"):
            async with server.http.get(URL(f"{server.url}/api/v1/logs/{other}", encoded=True)) as response:
                assert (response.status, b"secret" in await response.read()) == (404, False), other

    async def run() -> None:
        load, source = recorded()
        async with served(source, load.fleet, logs=folder) as server:
            await work(server)
        async with served(source, load.fleet) as server:
            assert await server.get("/api/v1/logs") == (200, {"has_folder": False, "files": []})

    asyncio.run(run())
