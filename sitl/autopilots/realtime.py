"""A stand-in autopilot behind sockets, in real time."""

from __future__ import annotations

import asyncio
import contextlib
import functools
import selectors
import signal
import time
from collections.abc import Iterator
from pathlib import Path

from companion.config.file import ConfigError
from companion.link.tick import LateLoopLog
from sitl.autopilots.autopilot import DT_S, Autopilot
from sitl.autopilots.behaviour import BEHAVIOURS
from sitl.links.ports import GROUND_STATION_PORT, LOOPBACK, Ports
from sitl.links.sockets import TcpLink, UdpLink
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.truth import TruthLog

MAX_LAG_S = 0.5  # longer pauses of the machine are skipped
PORT_HINT = "stop what uses the port, or move all ports with --port-offset"


def run_autopilot(file: AutopilotFile, ports: Ports, truth: Path | None, seconds: float | None) -> None:
    """Run until SIGTERM, SIGINT or `seconds` have passed. Raises ConfigError for a port in use or an unwritable file."""
    with contextlib.ExitStack() as stack:
        try:
            log = TruthLog(stack.enter_context(truth.open("w", encoding="ascii"))) if truth else None
        except OSError as error:
            raise ConfigError(f"--truth {truth}", "", f"{error.strerror}; name a file that can be written") from error
        with asyncio.Runner(loop_factory=lambda: asyncio.SelectorEventLoop(selectors.SelectSelector())) as runner:
            runner.run(_run(file, ports, log, seconds))


@contextlib.contextmanager
def _named_port(protocol: str, port: int) -> Iterator[None]:
    """Raises ConfigError instead of an OSError."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{protocol} port {port}", "", f"{error.strerror}; {PORT_HINT}") from error


async def _run(file: AutopilotFile, ports: Ports, log: TruthLog | None, seconds: float | None) -> None:
    loop = asyncio.get_running_loop()
    done = asyncio.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, done.set)
    behaviour = BEHAVIOURS[file.stand_in.autopilot]
    autopilot = behaviour.vehicle(file, DT_S)
    autopilot.flight_logs.utc_at_start_s = time.time()
    onboard = UdpLink(behaviour.onboard_link(autopilot), (LOOPBACK, ports.companion))
    ground = UdpLink(behaviour.ground_link(autopilot), (LOOPBACK, GROUND_STATION_PORT))
    links: list[UdpLink | TcpLink] = [onboard, ground]
    for link, port in ((onboard, ports.onboard), (ground, ports.ground_link)):
        with _named_port("UDP", port):
            await loop.create_datagram_endpoint(lambda link=link: link, local_addr=(LOOPBACK, port))  # type: ignore[misc]
    where = f"UDP {ports.onboard} to {ports.companion}, ground station on {ports.ground_link}"
    if behaviour.tcp_link:
        tcp = TcpLink(behaviour.tcp_link(autopilot))
        links.append(tcp)
        with _named_port("TCP", ports.tcp):
            await loop.create_server(tcp.accept, LOOPBACK, ports.tcp)
        where = f"TCP {ports.tcp}, {where}"
    print(f"vehicle {file.id}: MAVLink on {where}", flush=True)
    end_s = time.monotonic() + seconds if seconds is not None else float("inf")
    await _fly(autopilot, tuple(links), log, done, end_s)
    if log:
        log.flush()


async def _fly(
    autopilot: Autopilot, links: tuple[UdpLink | TcpLink, ...], log: TruthLog | None, done: asyncio.Event, end_s: float
) -> None:
    """Step whenever a step is due; after a late wake-up catch up by at most MAX_LAG_S."""
    next_s = time.monotonic()
    steps = 0
    late = LateLoopLog(functools.partial(print, flush=True))
    while not done.is_set() and next_s < end_s:
        now_s = time.monotonic()
        late.cycle(next_s, now_s)
        next_s = max(next_s, now_s - MAX_LAG_S)
        while next_s <= now_s:
            autopilot.step()
            autopilot.flight_logs.write(autopilot)
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
