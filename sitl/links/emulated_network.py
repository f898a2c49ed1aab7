"""The network between the agents of one machine, emulated in user space: `python -m sitl.links.emulated_network FILE`.

Vehicle J reaches vehicle I at the address 127.1.I.J, where this process listens: for the TCP streams of Zenoh, which the
vehicle with the larger id opens (sitl/flight/files.py), and for datagrams. All of 127.0.0.0/8 is loopback on Linux. On SIGHUP
the file is read again, so that a test can change the links of a fleet in flight.
"""

from __future__ import annotations

import asyncio
import selectors
import signal
import sys
from functools import partial
from itertools import permutations
from pathlib import Path as FilePath
from typing import Annotated

from msgspec import Meta

from companion.config.file import ConfigError, load
from companion.config.values import Section, VehicleId
from sitl.links.emulated_datagrams import EmulatedDatagrams
from sitl.links.emulated_streams import StreamDirection
from sitl.links.impairment import Path
from sitl.links.ports import LOOPBACK, ports_of
from sitl.vehicle.config import Links


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
        self._connections: set[asyncio.Task[None]] = set()
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
        there, here = self._paths[sender, receiver], self._paths[receiver, sender]
        port = ports_of(receiver, self._network.port_offset).zenoh
        front, back = (emulated_host(receiver, sender), port), (LOOPBACK, port)
        EmulatedDatagrams(front, back, there, self._epoch_s)
        await asyncio.start_server(partial(self._accept, back, there, here), *front)

    def _accept(
        self,
        back: tuple[str, int],
        there: Path,
        here: Path,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
    ) -> None:
        task = asyncio.get_running_loop().create_task(self._connect(back, there, here, reader, writer))
        self._connections.add(task)
        task.add_done_callback(self._connections.discard)

    async def _connect(
        self,
        back: tuple[str, int],
        there: Path,
        here: Path,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
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
