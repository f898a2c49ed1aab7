"""Who may use the server: real requests over loopback, as an attacker's page or another program would send them."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Awaitable, Callable
from contextlib import suppress
from pathlib import Path

import pytest
from aiohttp import ClientSession, WSServerHandshakeError

from companion.monitor.access import LONGEST_MESSAGE, MOST_CLIENTS, MOST_CONNECTIONS, is_loopback
from companion.monitor.api import TOKEN_HEADER
from companion.monitor.server import LONGEST_BODY, Site
from live_site import Served, recorded, served


def with_server(work: Callable[[Served], Awaitable[None]], tiles: Path | None = None) -> None:
    async def run() -> None:
        load, source = recorded()
        async with served(source, load.fleet, tiles=tiles) as server:
            await work(server)

    asyncio.run(run())


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("127.0.0.1:{port}", 200),
        ("localhost:{port}", 200),
        ("LOCALHOST", 200),
        ("localhost:9999", 200),  # through ssh -L
        (f"{socket.gethostname()}:1", 200),
        ("evil.example", 403),
        ("127.0.0.1.evil.example", 403),
        ("evil.example:{port}", 403),
        ("127.0.0.1@evil.example", 403),
        ("192.0.2.1", 403),
    ],
)
def test_host_must_be_a_name_of_the_server(host: str, status: int) -> None:
    async def work(server: Served) -> None:
        name = host.format(port=server.url.rpartition(":")[2])
        assert (await server.get("/api/v1/snapshot", Host=name))[0] == status

    with_server(work)


def test_host_may_be_the_name_that_the_server_listens_by(monkeypatch: pytest.MonkeyPatch) -> None:
    app = Site.app
    monkeypatch.setattr(Site, "app", lambda site, _address: app(site, "Ground.example.org"))

    async def work(server: Served) -> None:
        assert (await server.get("/api/v1/snapshot", Host="ground.example.org:8600"))[0] == 200
        status, answer = await server.get("/api/v1/snapshot", Host="other.example.org:8600")
        assert (status, "--listen NAME:PORT" in answer["error"]) == (403, True)

    with_server(work)


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://127.0.0.1:1", "file://"])
def test_another_page_can_neither_post_nor_listen(origin: str) -> None:
    async def work(server: Served) -> None:
        status, answer = await server.post("/api/v1/alarms/1/acknowledge", {}, Origin=origin)
        assert (status, answer["error"].split()[0]) == (403, "Origin")
        with pytest.raises(WSServerHandshakeError, match="403"):
            await server.http.ws_connect(f"{server.url}/api/v1/live", origin=origin)

    with_server(work)


@pytest.mark.parametrize("header", ["Sec-WebSocket-Key", "Sec-WebSocket-Version"])
def test_a_handshake_that_is_no_plain_text_is_refused(header: str) -> None:
    async def work(server: Served) -> None:
        others = {"Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==", "Sec-WebSocket-Version": "13"}
        lines = ["GET /api/v1/live HTTP/1.1", "Upgrade: websocket", "Connection: Upgrade"]
        lines += [f"{name}: {value}" for name, value in others.items() if name != header]
        status, answer = await server.raw(lines, header.encode() + b": \xff")
        assert (status, answer["error"].split()[0]) == (400, f"{header}:")

    with_server(work)


def test_a_fault_of_the_server_is_told_in_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    async def work(server: Served) -> None:
        def fail() -> None:
            raise ArithmeticError("secret")

        monkeypatch.setattr(server.station, "history", fail)
        status, answer = await server.get("/api/v1/history")
        assert (status, "fault of this server" in answer["error"], "secret" in answer["error"]) == (500, True, False)

    with_server(work)


def test_the_own_page_may_listen_and_post() -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live", origin=server.url) as live:
            assert (await live.receive_json())["type"] == "snapshot"
        assert (await server.post("/api/v1/alarms/1/acknowledge", {}, Origin=server.url))[0] == 404

    with_server(work)


def test_every_answer_has_the_headers_that_confine_the_page() -> None:
    async def work(server: Served) -> None:
        for path in ("/", "/api/v1/snapshot", "/api/v1/none", "/tiles/1/1/1.png", "/metrics"):
            async with server.http.get(server.url + path) as response:
                policy = response.headers["Content-Security-Policy"]
                assert "default-src 'none'" in policy
                assert "unsafe" not in policy
                assert response.headers["X-Content-Type-Options"] == "nosniff"
        async with server.http.get(server.url + "/api/v1/snapshot") as response:
            assert response.headers["Cache-Control"] == "no-store"
            assert "Access-Control-Allow-Origin" not in response.headers

    with_server(work)


def test_without_control_no_command_is_accepted() -> None:
    async def work(server: Served) -> None:
        for path in ("commands", "preview"):
            status, answer = await server.post(
                f"/api/v1/{path}", {"fleet": "load", "name": "land"}, **{TOKEN_HEADER: ""}
            )
            assert (status, "--control" in answer["error"]) == (403, True)
        assert (await server.get("/api/v1/snapshot"))[1]["commands"] == ""
        assert await server.get("/api/v1/control", **{TOKEN_HEADER: ""}) == (200, {"allowed": False})

    with_server(work)


@pytest.mark.parametrize(
    "path",
    [
        "/../api.py",
        "/%2e%2e/api.py",
        "/..%2fapi.py",
        "//etc/passwd",
        "/js/../../api.py",
        "/tiles/1/1/../../../../etc/passwd",
        "/tiles/..%2f..%2f1/1/1.png",
        "/tiles/99/1/1.png",
        "/tiles/1/2/1.png",
        "/tiles/0/0/-1.png",
        "/api/v1/fleets/..%2f..",
        "/%00",
    ],
)
def test_no_path_leaves_the_page_and_the_tiles(path: str, tmp_path: Path) -> None:
    tiles = tmp_path / "tiles"
    tiles.mkdir()

    async def work(server: Served) -> None:
        host, port = server.url.removeprefix("http://").split(":")
        reader, writer = await asyncio.open_connection(host, int(port))
        writer.write(f"GET {path} HTTP/1.1\r\nHost: {host}:{port}\r\nConnection: close\r\n\r\n".encode())
        answer = await reader.read()
        writer.close()
        assert answer.split(b" ", 2)[1] in (b"400", b"404")
        assert b"root:" not in answer

    with_server(work, tiles)


def test_tiles_come_from_the_folder_alone(tmp_path: Path) -> None:
    tile, secret = tmp_path / "tiles" / "3" / "4" / "5.png", tmp_path / "secret.png"
    tile.parent.mkdir(parents=True)
    tile.write_bytes(b"\x89PNG tile")
    secret.write_bytes(b"secret")
    (tile.parent / "6.png").symlink_to(secret)

    async def work(server: Served) -> None:
        async with server.http.get(server.url + "/tiles/3/4/5.png") as response:
            assert (response.status, await response.read()) == (200, b"\x89PNG tile")
            assert response.content_type == "image/png"
        async with server.http.get(server.url + "/tiles/3/4/6.png") as response:
            assert response.status == 404

    with_server(work, tmp_path / "tiles")


def test_a_slow_folder_of_tiles_delays_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    found, is_file = threading.Event(), Path.is_file

    def is_file_slowly(path: Path) -> bool:
        return not found.wait(10.0) if path.name == "5.png" else is_file(path)

    async def work(server: Served) -> None:
        asked = asyncio.create_task(server.get("/tiles/3/4/5.png"))
        await asyncio.sleep(0.05)
        assert (await server.get("/api/v1/snapshot"))[0] == 200
        assert not asked.done()
        found.set()
        assert (await asked)[0] == 404

    monkeypatch.setattr(Path, "is_file", is_file_slowly)
    with_server(work, tmp_path)


def test_a_body_is_bounded_and_checked() -> None:
    async def work(server: Served) -> None:
        async with server.http.post(
            server.url + "/api/v1/alarms/1/acknowledge", data=b"x" * (LONGEST_BODY + 1)
        ) as response:
            assert response.status in (404, 413)
        async with server.http.put(server.url + "/api/v1/commands", data=b"{}") as response:
            assert response.status == 405

    with_server(work)


@pytest.mark.parametrize(
    "message", ["nonsense", '{"type":"seek"}', '{"type":"speed","speed":1e9}', '{"type":"rm"}', "[" * 900, "9" * 5000]
)
def test_a_message_that_is_none_ends_the_connection_alone(message: str) -> None:
    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:
            await live.receive_json()
            await live.send_str(message)
            while not (received := await live.receive()).type.name.startswith("CLOS"):
                pass
            assert received.data in (1003, 1009) or len(message) > LONGEST_MESSAGE
        assert (await server.get("/api/v1/snapshot"))[0] == 200

    with_server(work)


def test_clients_are_bounded() -> None:
    async def work(server: Served) -> None:
        async with ClientSession() as http:
            sockets = [await http.ws_connect(f"{server.url}/api/v1/live") for _ in range(MOST_CLIENTS)]
            for socket_ in sockets:
                await socket_.receive()
            with pytest.raises(WSServerHandshakeError, match="503"):
                await http.ws_connect(f"{server.url}/api/v1/live")
            await sockets[0].close()
            async with asyncio.timeout(10.0):
                while server.site.clients.count >= MOST_CLIENTS:
                    await asyncio.sleep(0.01)
            async with http.ws_connect(f"{server.url}/api/v1/live") as live:
                assert (await live.receive_json())["type"] == "snapshot"

    with_server(work)


def test_connections_without_a_request_keep_nobody_out() -> None:
    """As of a stranger in the network who wants no ABORT to come through."""

    async def work(server: Served) -> None:
        async with server.http.ws_connect(f"{server.url}/api/v1/live") as live:
            address = server.url.removeprefix("http://").split(":")
            idle = [await asyncio.open_connection(*address) for _ in range(2 * MOST_CONNECTIONS)]
            assert (await server.get("/api/v1/snapshot"))[0] == 200
            for _ in range(3):
                assert (await live.receive_json())["type"] == "snapshot"
            async with asyncio.timeout(10.0):
                for reader, _ in idle[: MOST_CONNECTIONS // 2]:  # the oldest were closed
                    with suppress(ConnectionResetError):
                        assert await reader.read() == b""
            for _, writer in idle:
                writer.close()

    with_server(work)


def test_one_address_with_connections_ends_no_request_of_another() -> None:
    """One that takes long to send its request, as over a slow network."""

    async def work(server: Served) -> None:
        port = int(server.url.rpartition(":")[2])
        reader, slow = await asyncio.open_connection("127.0.0.1", port, local_addr=("127.0.0.2", 0))
        slow.write(b"GET /api/v1/snapshot HTTP/1.1\r\n")
        idle = [await asyncio.open_connection("127.0.0.1", port) for _ in range(2 * MOST_CONNECTIONS)]
        slow.write(f"Host: 127.0.0.1:{port}\r\n\r\n".encode())
        assert (await reader.readline()).startswith(b"HTTP/1.1 200")
        for writer in [slow, *(writer for _, writer in idle)]:
            writer.close()

    with_server(work)


@pytest.mark.parametrize(
    ("address", "loopback"),
    [("127.0.0.1", True), ("[::ffff:127.0.0.1]", True), ("127.8.8.8", True), ("[::1]", True), ("localhost", True),
     ("0.0.0.0", False), ("[::]", False), ("192.168.1.5", False), ("ground", False)],
)  # fmt: skip
def test_an_address_that_others_reach_is_no_loopback(address: str, loopback: bool) -> None:
    assert is_loopback(address) is loopback
