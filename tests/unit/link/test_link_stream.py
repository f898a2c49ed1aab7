"""TCP and serial links: both directions, reconnection, full buffers. Real sockets and a pseudo-terminal."""

from __future__ import annotations

import asyncio
import os
import socket
import tty
from collections.abc import Callable
from pathlib import Path

import pytest

from companion.link.byte_links import LinkError, SerialLine, StreamLink, TcpConnection


class Received:
    def __init__(self) -> None:
        self.data = b""

    def __call__(self, data: bytes, _received_s: float) -> bool:
        self.data += data
        return True


def ignore() -> None:
    """All is read."""


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(10.0):
        while not condition():
            await asyncio.sleep(0.005)


def listener(port: int = 0) -> socket.socket:
    server = socket.socket()
    server.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    server.bind(("127.0.0.1", port))
    server.listen()
    server.settimeout(10.0)
    return server


def test_tcp_reconnects_after_the_autopilot_closed() -> None:
    async def scenario() -> None:
        with listener() as server:
            port = server.getsockname()[1]
        received = Received()
        link = StreamLink(TcpConnection("127.0.0.1", port), received, ignore)
        task = asyncio.create_task(link.run())
        await until(lambda: "no program listens" in link.problem())
        link.send(b"lost, never kept")
        for greeting in (b"first", b"second"):
            with listener(port) as server:
                connection, _ = await asyncio.to_thread(server.accept)
                connection.settimeout(10.0)
                with connection:
                    connection.sendall(greeting)
                    await until(lambda word=greeting: received.data.endswith(word))
                    link.send(b"answer to " + greeting)
                    assert connection.recv(100) == b"answer to " + greeting
        task.cancel()

    asyncio.run(scenario())


def test_tcp_peer_that_does_not_read_loses_only_whole_messages() -> None:
    async def scenario() -> None:
        with listener() as server:
            server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
            received = Received()
            link = StreamLink(TcpConnection("127.0.0.1", server.getsockname()[1]), received, ignore)
            task = asyncio.create_task(link.run())
            connection, _ = await asyncio.to_thread(server.accept)
            with connection:
                connection.sendall(b"hello")
                await until(lambda: received.data == b"hello")
                sent = 0
                for number in range(5000):
                    link.send(b"%04d" % number * 250)  # whole messages of 1000 bytes
                    sent += 1
                    if number % 50 == 0:
                        await asyncio.sleep(0)
                task_is_alive = not task.done()
                connection.setblocking(False)
                got = b""
                for _ in range(200):
                    try:
                        got += connection.recv(65536)
                    except BlockingIOError:
                        await asyncio.sleep(0.005)
                assert task_is_alive
                assert 0 < len(got) < 1000 * sent  # most were dropped
                assert len(got) % 1000 == 0  # and what came, came whole
                for at in range(0, len(got), 1000):
                    message = got[at : at + 1000]
                    assert message == message[:4] * 250
            task.cancel()

    asyncio.run(scenario())


def terminal(name: Path) -> int:
    """A new pseudo-terminal with the link `name`; returns the other end."""
    master, slave = os.openpty()
    tty.setraw(slave)
    name.unlink(missing_ok=True)
    name.symlink_to(os.ttyname(slave))
    os.close(slave)
    os.set_blocking(master, False)
    return master


def read_some(fd: int) -> bytes:
    try:
        return os.read(fd, 4096)
    except BlockingIOError:
        return b""


def test_serial_port_is_reopened_after_it_was_unplugged(tmp_path: Path) -> None:
    async def scenario() -> None:
        device = tmp_path / "ttyAutopilot"
        received = Received()
        other_end = terminal(device)
        link = StreamLink(SerialLine(str(device), 57600), received, ignore)
        task = asyncio.create_task(link.run())
        for word in (b"before", b"after"):
            await until(lambda: "is open" in link.problem())
            os.write(other_end, word)
            await until(lambda wanted=word: received.data.endswith(wanted))
            link.send(b"setpoint")
            sent = b""
            async with asyncio.timeout(10.0):
                while sent != b"setpoint":
                    sent += read_some(other_end)
                    await asyncio.sleep(0.005)
            os.close(other_end)  # unplugged
            if word == b"before":
                device.unlink()
                await until(lambda: "is it plugged in?" in link.problem())
                other_end = terminal(device)
        task.cancel()

    asyncio.run(scenario())


def test_full_serial_port_does_not_block(tmp_path: Path) -> None:
    async def scenario() -> None:
        other_end = terminal(tmp_path / "ttyAutopilot")
        link = StreamLink(SerialLine(str(tmp_path / "ttyAutopilot"), 57600), Received(), ignore)
        task = asyncio.create_task(link.run())
        await asyncio.sleep(0.05)
        async with asyncio.timeout(10.0):
            for _ in range(5000):
                link.send(b"x" * 51)
            await asyncio.sleep(0.05)
        assert not task.done()
        took = b""
        async with asyncio.timeout(10.0):
            while some := read_some(other_end):
                took += some
                await asyncio.sleep(0.01)
        assert 0 < len(took) < 51 * 5000  # most were dropped
        assert len(took) % 51 == 0  # and what came, came whole
        task.cancel()
        await asyncio.wait([task])
        os.close(other_end)

    asyncio.run(scenario())


def test_offered_packets_are_accepted_only_while_the_port_is_free(tmp_path: Path) -> None:
    async def scenario() -> None:
        other_end = terminal(tmp_path / "ttyAutopilot")
        link = StreamLink(SerialLine(str(tmp_path / "ttyAutopilot"), 57600), Received(), ignore)
        assert not link.offer(b"not open yet")
        task = asyncio.create_task(link.run())
        await asyncio.sleep(0.05)
        assert link.offer(b"packet")
        for _ in range(5000):
            link.send(b"x" * 51)
        assert not link.offer(b"not now")
        took = b""
        async with asyncio.timeout(10.0):
            while some := read_some(other_end):
                took += some
                await asyncio.sleep(0.01)
            while not link.offer(b"again"):
                await asyncio.sleep(0.01)
        assert took.startswith(b"packet")
        assert b"not" not in took
        task.cancel()
        await asyncio.wait([task])
        os.close(other_end)

    asyncio.run(scenario())


def test_serial_port_is_locked_for_one_program(tmp_path: Path) -> None:
    other_end = terminal(tmp_path / "ttyAutopilot")
    first = SerialLine(str(tmp_path / "ttyAutopilot"), 57600)
    with pytest.raises(LinkError, match="is in use"):
        SerialLine(str(tmp_path / "ttyAutopilot"), 57600)
    assert first.name.endswith("ttyAutopilot")
    os.close(other_end)
