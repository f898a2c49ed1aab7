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
from companion.mavlink.codec import MavlinkCodec, MavlinkMessage, mavlink
from sitl.config import AutopilotFile
from sitl.ports import GROUND_STATION_PORT, LOOPBACK, Ports
from sitl.px4 import DT_S, Px4
from sitl.px4_commands import Receiver
from sitl.px4_link import GROUND_RATES_HZ, HEARTBEAT_ONLY, ONBOARD_RATES_HZ, Schedule
from sitl.px4_messages import BUILDERS
from sitl.truth import TruthLog

MAX_LAG_S = 0.5  # a machine that slept does not fly the time it missed
GROUND_STATION_FORGOTTEN_S = 5.0
PORT_HINT = "stop what uses the port, or move all ports with --port-offset"


class Link(asyncio.DatagramProtocol):
    """One UDP link. Its peer is the first that sends, for the life of the process; until then `address`."""

    def __init__(
        self, px4: Px4, address: tuple[str, int], rates_hz: dict[int, float], heard_rates_hz: dict[int, float]
    ) -> None:
        self._px4 = px4
        self._address = address
        self._heard_rates_hz = heard_rates_hz
        self._heard = False
        self._speaks_fully = not heard_rates_hz
        self._origin_told: int | None = None
        self._codec = MavlinkCodec(px4.system_id, mavlink.MAV_COMP_ID_AUTOPILOT1)
        self.schedule = Schedule(rates_hz)
        self.receiver = Receiver(px4, self.schedule)
        self._transport: asyncio.DatagramTransport | None = None

    def connection_made(self, transport: asyncio.DatagramTransport) -> None:  # type: ignore[override]
        self._transport = transport

    def datagram_received(self, data: bytes, addr: tuple[str, int]) -> None:
        if not self._heard:
            self._heard, self._address = True, addr
            self._speaks_fully = True
            if self._heard_rates_hz:
                self.schedule.reset(self._heard_rates_hz, self._px4.time_s)
        elif addr != self._address:
            return
        for message in self._codec.decode(data):
            self.send(self.receiver.receive(message))

    def error_received(self, exc: Exception) -> None:
        """Nobody listens there yet."""

    def send(self, messages: Iterator[MavlinkMessage]) -> None:
        if self._transport is not None:
            for message in messages:
                self._transport.sendto(self._codec.encode(message), self._address)

    def send_due(self) -> None:
        if self._speaks_fully and self._origin_told != self._px4.origin_changes:
            # Once and on every change, as PX4 does.
            self._origin_told = self._px4.origin_changes
            self.send(iter([BUILDERS[mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN](self._px4)]))
        due = self.schedule.due(self._px4.time_s, self._px4.setpoint if self._px4.armed else None)
        self.send(BUILDERS[message_id](self._px4) for message_id in due)

    def listens_for_texts(self) -> bool:
        """STATUSTEXT goes only where a ground station's heartbeat comes from."""
        heard_s = self.receiver.ground_station_s
        return heard_s is not None and self._px4.time_s - heard_s < GROUND_STATION_FORGOTTEN_S


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
    px4 = Px4(file, DT_S)
    links = (
        Link(px4, (LOOPBACK, ports.companion), ONBOARD_RATES_HZ, {}),
        Link(px4, (LOOPBACK, GROUND_STATION_PORT), HEARTBEAT_ONLY, GROUND_RATES_HZ),
    )
    for link, port in zip(links, (ports.onboard, ports.ground_link), strict=True):
        try:
            await loop.create_datagram_endpoint(lambda link=link: link, local_addr=(LOOPBACK, port))  # type: ignore[misc]
        except OSError as error:
            raise ConfigError(f"UDP port {port}", "", f"{error.strerror}; {PORT_HINT}") from error
    ground = f"ground station on {ports.ground_link}"
    print(f"vehicle {file.id}: MAVLink on UDP {ports.onboard} to {ports.companion}, {ground}", flush=True)
    end_s = time.monotonic() + seconds if seconds is not None else float("inf")
    await _fly(px4, links, log, done, end_s)
    if log:
        log.flush()


async def _fly(px4: Px4, links: tuple[Link, ...], log: TruthLog | None, done: asyncio.Event, end_s: float) -> None:
    """Step whenever a step is due; after a late wake catch up, but never more than MAX_LAG_S."""
    next_s = time.monotonic()
    steps = 0
    while not done.is_set() and next_s < end_s:
        now_s = time.monotonic()
        next_s = max(next_s, now_s - MAX_LAG_S)
        while next_s <= now_s:
            px4.step()
            steps += 1
            _tell(px4, links)
            if log and steps % 5 == 0:
                log.write(px4, next_s)
            if log and steps % 250 == 0:
                log.flush()
            next_s += DT_S
        await asyncio.sleep(max(0.0, next_s - time.monotonic()))


def _tell(px4: Px4, links: tuple[Link, ...]) -> None:
    for link in links:
        if px4.texts and link.listens_for_texts():
            link.send(link.receiver.texts(px4.texts))
        link.send_due()
    px4.texts.clear()
