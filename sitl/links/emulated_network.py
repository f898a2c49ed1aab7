"""The network between the agents of one machine, emulated in user space: `python -m sitl.links.emulated_network FILE`.

Vehicle J reaches vehicle I at the address 127.1.I.J, where this process listens: for the TCP streams of Zenoh, which the
vehicle with the larger id opens (sitl/flight/files.py), and for datagrams. All of 127.0.0.0/8 is loopback on Linux. On SIGHUP
the file is read again, so that a test can change the links of a fleet in flight.

Streams: bytes are never lost; a lost segment is sent again, and all that follow wait for it. It is a model of a sender for
small messages: what is written while a segment waits for its retransmission goes out with it. The first retransmission comes
after a round trip, when later segments show the loss (RFC 8985), the next ones after the retransmission timeout, which
doubles each time (RFC 6298, with the least timeout of Linux).
"""

from __future__ import annotations

import asyncio
import selectors
import signal
import sys
from collections.abc import Awaitable, Callable
from contextlib import suppress
from functools import partial
from itertools import permutations
from pathlib import Path as FilePath
from typing import Annotated, cast

from msgspec import Meta

from companion.config.file import ConfigError, load
from companion.config.values import Section, VehicleId
from sitl.links.network import Path
from sitl.links.ports import LOOPBACK, ports_of
from sitl.vehicle.config import Links

SHOWN_BY_LATER_SEGMENTS_S = 0.02  # they follow one tick later
LEAST_TIMEOUT_S = 0.2
LONGEST_TIMEOUT_S = 120.0
WAITING_BYTES = 1 << 20  # then the sender is no longer read

Connect = Callable[[], Awaitable[asyncio.StreamWriter]]
Address = tuple[str, int]


class StreamDirection:
    """One direction of one connection. `connect` opens the receiver's end when the first segment arrives."""

    def __init__(self, path: Path, reader: asyncio.StreamReader, connect: Connect, epoch_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._path, self._reader, self._connect, self._epoch_s = path, reader, connect, epoch_s
        self._written, self._waiting, self._is_open = bytearray(), asyncio.Event(), True
        self._in_transit: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue()
        self._is_connected = False

    async def run(self) -> None:
        """Pass bytes on until the sender closes. Raises OSError where the receiver has closed."""
        async with asyncio.TaskGroup() as group:
            for part in (self._read, self._transmit, self._deliver):
                group.create_task(part())

    async def _read(self) -> None:
        while self._is_open:
            while len(self._written) > WAITING_BYTES:
                await asyncio.sleep(0.01)
            data = b""
            with suppress(ConnectionError):
                data = await self._reader.read(65_536)
            self._written += data
            self._is_open = bool(data)
            self._waiting.set()

    async def _transmit(self) -> None:
        arrives_s = 0.0
        while self._is_open or self._written:
            await self._waiting.wait()
            self._waiting.clear()
            await self._until_sent_once()
            if not self._is_open and not self._is_connected:
                break  # the sender gave up before the connection was established
            segment, self._written = bytes(self._written), bytearray()
            arrives_s = max(arrives_s, self._loop.time() + self._path.delay_s())
            self._in_transit.put_nowait((arrives_s, segment))
        self._in_transit.put_nowait((arrives_s, b""))

    async def _until_sent_once(self) -> None:
        """Wait for the retransmissions of the first segment that waits."""
        links = self._path.links
        round_trip_s = 2.0 * links.peer_delay_s + links.peer_jitter_s
        wait_s, timeout_s = round_trip_s + SHOWN_BY_LATER_SEGMENTS_S, max(LEAST_TIMEOUT_S, 2.0 * round_trip_s)
        while self._path.loses() or self._path.is_cut(self._loop.time() - self._epoch_s):
            await asyncio.sleep(wait_s)
            wait_s, timeout_s = timeout_s, min(2.0 * timeout_s, LONGEST_TIMEOUT_S)

    async def _deliver(self) -> None:
        writer: asyncio.StreamWriter | None = None
        try:
            while True:
                arrives_s, segment = await self._in_transit.get()
                await asyncio.sleep(arrives_s - self._loop.time())
                if not segment:
                    return
                writer, self._is_connected = writer or await self._connect(), True
                writer.write(segment)
                await writer.drain()
        finally:
            if writer:
                writer.close()


class EmulatedDatagrams(asyncio.DatagramProtocol):
    """Forwards what it receives to `back`, where the receiver listens. Flight time begins at `epoch_s` of the loop."""

    def __init__(self, back: Address, path: Path, epoch_s: float) -> None:
        self._loop = asyncio.get_running_loop()
        self._back, self._path, self._epoch_s = back, path, epoch_s

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        self._transport = cast(asyncio.DatagramTransport, transport)  # asyncio's own is no subclass in Python 3.11

    def datagram_received(self, data: bytes, _addr: object) -> None:
        for arrives_s in self._path.arrivals_s(self._loop.time() - self._epoch_s):
            self._loop.call_at(self._epoch_s + arrives_s, self._transport.sendto, data, self._back)


class NetworkFile(Section, frozen=True):
    """The emulated network of one fleet."""

    vehicles: tuple[VehicleId, ...]
    links: Links
    seed: Annotated[int, Meta(ge=0)] = 1
    port_offset: Annotated[int, Meta(ge=0)] = 0


def emulated_host(receiving_id: int, sending_id: int) -> str:
    """The address at which one agent reaches another over the emulated network."""
    return f"127.1.{receiving_id}.{sending_id}"


class EmulatedNetwork:
    """All paths of one fleet; streams and datagrams share the path of each direction."""

    def __init__(self, file: FilePath) -> None:
        """Raises ConfigError."""
        self._file = file
        self._network = load(file, NetworkFile)
        self._paths: dict[tuple[int, int], Path] = {}
        self._epoch_s = 0.0

    async def run(self) -> None:
        """Serve until SIGTERM or SIGINT. Raises OSError where an address cannot be bound."""
        loop, ended = asyncio.get_running_loop(), asyncio.Event()
        self._epoch_s = loop.time()
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, ended.set)
        loop.add_signal_handler(signal.SIGHUP, self._read_again)
        links, seed = self._network.links, self._network.seed
        self._paths = {(i, j): Path(i, j, links, seed) for i, j in permutations(self._network.vehicles, 2)}
        for sender, receiver in self._paths:
            await self._listen(sender, receiver)
        print(f"network of vehicles {', '.join(map(str, self._network.vehicles))}", flush=True)
        await ended.wait()

    async def _listen(self, sender: int, receiver: int) -> None:
        there, here, epoch_s = self._paths[sender, receiver], self._paths[receiver, sender], self._epoch_s
        port = ports_of(receiver, self._network.port_offset).zenoh
        front, back = (emulated_host(receiver, sender), port), (LOOPBACK, port)
        loop = asyncio.get_running_loop()
        await loop.create_datagram_endpoint(lambda: EmulatedDatagrams(back, there, epoch_s), front)
        await asyncio.start_server(partial(self._carry, back, there, here), *front)

    async def _carry(
        self, back: Address, there: Path, here: Path, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Carry one connection. Its far end is opened when the first segment arrives there."""
        answers: list[asyncio.Task[None]] = []

        async def towards_client() -> asyncio.StreamWriter:
            return writer

        async def towards_back() -> asyncio.StreamWriter:
            far_reader, far_writer = await asyncio.open_connection(*back)
            direction = StreamDirection(here, far_reader, towards_client, self._epoch_s)
            answers.append(asyncio.get_running_loop().create_task(direction.run()))
            return far_writer

        try:
            await StreamDirection(there, reader, towards_back, self._epoch_s).run()
            await asyncio.gather(*answers)
        except* OSError:  # one end has gone
            pass
        finally:
            for task in answers:
                task.cancel()
            await asyncio.gather(*answers, return_exceptions=True)
            writer.close()

    def _read_again(self) -> None:
        try:
            links = load(self._file, NetworkFile).links
        except ConfigError as error:
            print(error, file=sys.stderr, flush=True)
            return
        for path in self._paths.values():
            path.links = links
        print("links changed", flush=True)


def main() -> None:
    """Run the network of the file that is the only argument. Raises SystemExit."""
    try:
        network = EmulatedNetwork(FilePath(sys.argv[1]))
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
            runner.run(network.run())
    except (ConfigError, OSError) as error:
        raise SystemExit(f"emulated network: {error}") from error


if __name__ == "__main__":
    main()
