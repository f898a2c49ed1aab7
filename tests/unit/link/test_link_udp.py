"""The UDP link: address of the autopilot, age of datagrams, errors at opening."""

from __future__ import annotations

import asyncio
import socket
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from companion.link.byte_links import LinkError, UdpLink, open_link
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind

HOST = "127.0.0.1"
HEARTBEAT = MavlinkCodec(3, 1).encode(
    mavlink.MAVLink_heartbeat_message(mavlink.MAV_TYPE_QUADROTOR, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)
)


@contextmanager
def sender(port: int) -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.connect((HOST, port))
        udp.settimeout(5.0)
        yield udp


@contextmanager
def free_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as udp:
        udp.bind((HOST, 0))
        port = udp.getsockname()[1]
    yield port


async def until(condition: Callable[[], object]) -> None:
    async with asyncio.timeout(5.0):
        while not condition():
            await asyncio.sleep(0.002)


class Recorder:
    """Records what a link receives; datagrams that begin with b"A" are from the autopilot."""

    def __init__(self) -> None:
        self.received: list[tuple[bytes, float]] = []

    def __call__(self, data: bytes, received_s: float) -> bool:
        self.received.append((data, received_s))
        return data.startswith(b"A")

    def data(self) -> list[bytes]:
        return [data for data, _ in self.received]


def ignore() -> None:
    """All is read."""


def test_only_the_autopilot_address_is_used() -> None:
    async def scenario(port: int) -> None:
        recorder = Recorder()
        link = UdpLink(HOST, port, recorder, ignore)
        task = asyncio.create_task(link.run())
        with sender(port) as stranger, sender(port) as autopilot, sender(port) as second:
            link.send(b"no address yet")
            stranger.send(b"S1")
            await until(lambda: recorder.data() == [b"S1"])
            link.send(b"still no address")
            autopilot.send(b"A1")
            await until(lambda: b"A1" in recorder.data())
            second.send(b"A from elsewhere")
            stranger.send(b"S2")
            autopilot.send(b"A2")
            await until(lambda: b"A2" in recorder.data())
            assert recorder.data() == [b"S1", b"A1", b"A2"]
            link.send(b"setpoint")
            assert autopilot.recv(100) == b"setpoint"
            for other in (stranger, second):
                other.setblocking(False)
                with pytest.raises(BlockingIOError):
                    other.recv(100)
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_another_address_with_the_autopilot_s_id_is_named_once(caplog: pytest.LogCaptureFixture) -> None:
    async def scenario(port: int) -> None:
        recorder, translator = Recorder(), Translator(3, AutopilotKind.PX4)

        def received(data: bytes, received_s: float) -> bool:
            return recorder(data, received_s) or bool(translator.telemetry(data, received_s))

        link = UdpLink(HOST, port, received, ignore, translator.receive_beside)
        task = asyncio.create_task(link.run())
        with sender(port) as autopilot, sender(port) as second:
            for _ in range(6):
                count = len(recorder.received)
                if count:
                    second.send(HEARTBEAT)
                autopilot.send(HEARTBEAT)
                await until(lambda count=count: len(recorder.received) > count)
            link.send(b"setpoint")
            assert autopilot.recv(100) == b"setpoint"  # the first one is followed as before
            warnings = [record.getMessage() for record in caplog.records if record.levelname == "WARNING"]
            followed, other = (f"{HOST}:{one.getsockname()[1]}" for one in (autopilot, second))
            assert warnings == [f"an autopilot with the same id sends from {other}, too; {followed} is followed"]
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_a_flood_from_another_address_is_looked_at_now_and_then() -> None:
    async def scenario(port: int) -> None:
        recorder, looked = Recorder(), Recorder()
        link = UdpLink(HOST, port, recorder, ignore, looked)
        task = asyncio.create_task(link.run())
        with sender(port) as autopilot, sender(port) as other:
            autopilot.send(b"A1")
            await until(recorder.data)
            for _ in range(20):
                for _ in range(50):
                    other.send(b"Another")
                autopilot.send(b"A2")
                await asyncio.sleep(0)
            await until(lambda: len(recorder.received) > 20)
            assert 0 < len(looked.received) < 1000
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_autopilot_is_found_at_another_port_after_silence(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def scenario(port: int) -> None:
        recorder = Recorder()
        link = UdpLink(HOST, port, recorder, ignore)
        task = asyncio.create_task(link.run())
        with sender(port) as before, sender(port) as after:
            before.send(b"A1")
            await until(recorder.data)
            monkeypatch.setattr("companion.link.byte_links.RELOCK_AFTER_S", 0.0)
            after.send(b"A2")
            await until(lambda: b"A2" in recorder.data())
            link.send(b"hello")
            assert after.recv(100) == b"hello"
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_receipt_time_includes_the_wait_in_the_kernel() -> None:
    async def scenario(port: int) -> None:
        recorder = Recorder()
        link = UdpLink(HOST, port, recorder, ignore)
        with sender(port) as autopilot:
            before_s = time.monotonic()
            autopilot.send(b"A waiting")
            sent_s = time.monotonic()
            time.sleep(0.3)  # the process hangs
            task = asyncio.create_task(link.run())
            await until(recorder.received.__len__)
            _, received_s = recorder.received[0]
            assert before_s - 0.05 <= received_s <= sent_s + 0.05
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_link_continues_when_the_autopilot_port_is_closed() -> None:
    """The kernel reports a closed port as an error of a later call."""

    async def scenario(port: int) -> None:
        recorder = Recorder()
        link = UdpLink(HOST, port, recorder, ignore)
        task = asyncio.create_task(link.run())
        with sender(port) as autopilot:
            autopilot.send(b"A1")
            await until(recorder.data)
        for _ in range(5):
            link.send(b"no receiver")
            await asyncio.sleep(0.01)
        assert not task.done()
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_what_waits_together_is_read_together() -> None:
    async def scenario(port: int) -> None:
        recorder, read = Recorder(), list[int]()
        link = UdpLink(HOST, port, recorder, lambda: read.append(len(recorder.received)))
        with sender(port) as autopilot:
            for _ in range(3):
                autopilot.send(b"A")
            task = asyncio.create_task(link.run())
            await until(lambda: read)
            assert read == [3]
            autopilot.send(b"A")
            await until(lambda: read == [3, 4])
        task.cancel()
        link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_flood_does_not_starve_the_event_loop() -> None:
    """Each datagram that is read triggers the next: the socket is never empty."""

    async def scenario(port: int) -> None:
        with sender(port) as stranger:
            read_before_the_tick: list[int] = []
            read = 0

            def flood(_data: bytes, _received_s: float) -> bool:
                nonlocal read
                read += 1
                if read == 1:
                    asyncio.get_running_loop().call_soon(lambda: read_before_the_tick.append(read))
                if read < 1000:
                    stranger.send(b"S")
                return False

            link = UdpLink(HOST, port, flood, ignore)
            task = asyncio.create_task(link.run())
            stranger.send(b"S")
            await until(lambda: read == 1000)
            assert read_before_the_tick[0] <= 64
            task.cancel()
            link.close()

    with free_port() as port:
        asyncio.run(scenario(port))


def test_port_in_use_is_reported() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind((HOST, 0))
        port = other.getsockname()[1]
        with pytest.raises(LinkError, match=f"UDP port {port} is in use; stop"):
            open_link(f"udpin:{HOST}:{port}", Recorder(), ignore)


@pytest.mark.parametrize(
    ("endpoint", "words"),
    [
        ("udpin:no-such-host.invalid:14540", "use 0.0.0.0"),
        ("udpin:192.0.2.1:24590", "no such address"),
        ("udpin:127.0.0.1:70000", "expected 1 to 65535"),
        ("tcp:127.0.0.1:0", "expected 1 to 65535"),
        ("udpin:127.0.0.1:" + "1" * 5000, "has 5000 digits"),
        ("udpin:127.0.0..1:14540", "neither an address nor a name"),
        ("tcp:127.0.0..1:14540", "neither an address nor a name"),
        ("udpin:" + "a" * 64 + ":14540", "neither an address nor a name"),
        ("tcp:" + "a" * 64 + ".local:14540", "neither an address nor a name"),
        ("udpin:127.0.0.1\0:14540", "zero byte"),
        ("serial:/dev/no-such-device:57600", "there is no serial device /dev/no-such-device"),
        ("serial:/dev/null:57600", "is not a serial device"),
        ("serial:/tmp:57600", "serial device /tmp"),
    ],
)
def test_invalid_endpoint_is_reported_in_one_line(endpoint: str, words: str) -> None:
    with pytest.raises(LinkError) as caught:
        open_link(endpoint, Recorder(), ignore)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
