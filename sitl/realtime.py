"""The stand-in autopilot behind UDP, in step with the monotonic clock."""

from __future__ import annotations

import asyncio
import contextlib
import selectors
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from companion.config_file import ConfigError
from sitl.autopilot import DT_S, Autopilot
from sitl.config import AutopilotFile
from sitl.link_end import LinkEnd
from sitl.manners import PX4
from sitl.ports import GROUND_STATION_PORT, LOOPBACK, Ports
from sitl.truth import TruthLog

MAX_LAG_S = 0.5  # a machine that slept does not fly the time it missed
PORT_HINT = "stop what uses the port, or move all ports with --port-offset"


class Link(asyncio.DatagramProtocol):
    """One UDP link. Its peer is the first that sends, for the life of the process; until then `address`."""

    def __init__(self, end: LinkEnd, address: tuple[str, int]) -> None:
        self._end = end
        self._address = address
        self._heard = False
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if not self._heard:
            self._heard, self._address = True, addr
            self._end.heard()
        elif addr != self._address:
            return
        self._send(self._end.receive(data))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet."""

    def send_due(self) -> None:
        self._send(self._end.due())

    def _send(self, packets: Iterator[bytes]) -> None:
        for packet in packets:
            if self._transport is not None:
                self._transport.sendto(packet, self._address)


def run(file: AutopilotFile, ports: Ports, truth: Path | None, seconds: float | None) -> None:
    """Fly until SIGTERM, SIGINT or `seconds` have passed. Raises ConfigError for a port in use or a file it cannot write."""
    with contextlib.ExitStack() as stack:
        try:
            log = TruthLog(stack.enter_context(truth.open("w", encoding="ascii"))) if truth else None
        except OSError as error:
            raise ConfigError(f"--truth {truth}", "", f"{error.strerror}; name a file that can be written") from error
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
            runner.run(_run(file, ports, log, seconds))


async def _run(file: AutopilotFile, ports: Ports, log: TruthLog | None, seconds: float | None) -> None:
    loop = asyncio.get_running_loop()
    done = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, done.set)
    autopilot = PX4.vehicle(file, DT_S)
    links = (
        Link(PX4.onboard_link(autopilot), (LOOPBACK, ports.companion)),
        Link(PX4.ground_link(autopilot), (LOOPBACK, GROUND_STATION_PORT)),
    )
    for link, port in zip(links, (ports.onboard, ports.ground_link), strict=True):
        try:
            await loop.create_datagram_endpoint(lambda link=link: link, local_addr=(LOOPBACK, port))  # type: ignore[misc]
        except OSError as error:
            raise ConfigError(f"UDP port {port}", "", f"{error.strerror}; {PORT_HINT}") from error
    ground = f"ground station on {ports.ground_link}"
    print(f"vehicle {file.id}: MAVLink on UDP {ports.onboard} to {ports.companion}, {ground}", flush=True)
    end_s = time.monotonic() + seconds if seconds is not None else float("inf")
    await _fly(autopilot, links, log, done, end_s)
    if log:
        log.flush()


async def _fly(
    autopilot: Autopilot, links: tuple[Link, ...], log: TruthLog | None, done: asyncio.Event, end_s: float
) -> None:
    """Step whenever a step is due; after a late wake catch up, but never more than MAX_LAG_S."""
    next_s = time.monotonic()
    steps = 0
    while not done.is_set() and next_s < end_s:
        now_s = time.monotonic()
        next_s = max(next_s, now_s - MAX_LAG_S)
        while next_s <= now_s:
            autopilot.step()
            steps += 1
            for link in links:
                link.send_due()
            autopilot.texts.clear()
            if log and steps % 5 == 0:
                log.write(autopilot, next_s)
            if log and steps % 250 == 0:
                log.flush()
            next_s += DT_S
        await asyncio.sleep(max(0.0, next_s - time.monotonic()))
