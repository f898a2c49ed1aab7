"""Stand-in autopilots behind sockets, in real time: any number of them in one process, in one loop.

Sockets are read where a step begins, as an autopilot does, so that no packet wakes the process by itself.
"""

from __future__ import annotations

import contextlib
import functools
import gc
import os
import selectors
import signal
import socket
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Protocol

from companion.config.file import ConfigError
from companion.link.tick import LateLoopLog
from sitl.autopilots.autopilot import DT_S, Autopilot, AutopilotAbortedError
from sitl.autopilots.link_end import LinkEnd
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.links.cameras import truth_datagram
from sitl.links.ports import GROUND_STATION_PORT, LOOPBACK, Ports
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.truth import TRUTH_HEADER, truth_row

READ_BYTES = 65_536
DATAGRAMS_PER_STEP = 64  # of one link; the rest waits for the next step
MOST_WAITING_BYTES = 65_536  # for a client that does not read; further packets are dropped
MAX_LAG_S = 0.5  # longer pauses of the machine are skipped
TRUTH_STEPS, FLUSH_STEPS = 5, 250
CAPTURE_STEPS = 2  # between true poses for a motion-capture system
GROUPS = 4  # of vehicles, 1 ms after each other
PORT_HINT = "stop what uses the port, or move all ports with --port-offset"


class SocketLink(Protocol):
    """One link behind a socket. Its constructor registers what reads the socket."""

    def send(self, packets: Iterable[bytes]) -> None:
        """Send to the peer, if there is one."""

    def close(self) -> None:
        """Close the sockets."""


def _answers(end: LinkEnd, data: bytes) -> Iterator[bytes]:
    """Answers to received bytes. Aborts the process, with all its stand-ins, where the real autopilot aborts."""
    try:
        yield from end.receive(data)
    except AutopilotAbortedError as error:
        print(f"vehicle {end.system_id}: aborted by {error}", file=sys.stderr, flush=True)
        os.abort()


class UdpSocketLink:
    """One UDP link. Its peer is the first sender, for the life of the process; before, packets go to `address`."""

    def __init__(self, end: LinkEnd, port: int, address: tuple[str, int], selector: selectors.BaseSelector) -> None:
        """Raises OSError for a port in use."""
        self._end = end
        self._address = address
        self._connected = False
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setblocking(False)
            self._socket.bind((LOOPBACK, port))
        except OSError:
            self._socket.close()
            raise
        selector.register(self._socket, selectors.EVENT_READ, self._read)

    def close(self) -> None:
        self._socket.close()

    def _read(self) -> None:
        for _ in range(DATAGRAMS_PER_STEP):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                return
            except OSError:
                continue  # an ICMP error for an earlier packet: no process listens at the address yet
            if not self._connected:
                self._connected, self._address = True, sender
                self._end.peer_connected()
            if sender == self._address:
                self.send(_answers(self._end, data))

    def send(self, packets: Iterable[bytes]) -> None:
        for packet in packets:
            with contextlib.suppress(OSError):  # also for an earlier packet; a full buffer loses this one
                self._socket.sendto(packet, self._address)


class TcpSocketLink:
    """One TCP port. A second client is rejected while the first is connected.

    A later client finds the message rates unchanged.
    """

    def __init__(self, end: LinkEnd, port: int, selector: selectors.BaseSelector) -> None:
        """Raises OSError for a port in use."""
        self._end = end
        self._selector = selector
        self._client: socket.socket | None = None
        self._waiting = b""  # for the client
        self._server = socket.create_server((LOOPBACK, port))
        self._server.setblocking(False)
        selector.register(self._server, selectors.EVENT_READ, self._accept)

    def close(self) -> None:
        self._disconnect()
        self._server.close()

    def _accept(self) -> None:
        try:
            client, _ = self._server.accept()
        except OSError:
            return  # it has gone already
        if self._client is not None:
            client.close()
            return
        client.setblocking(False)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._client = client
        self._selector.register(client, selectors.EVENT_READ, self._read)
        self._end.peer_connected()

    def _disconnect(self) -> None:
        if self._client is not None:
            self._selector.unregister(self._client)
            self._client.close()
        self._client, self._waiting = None, b""

    def _read(self) -> None:
        if self._client is None:
            return
        try:
            data = self._client.recv(READ_BYTES)
        except BlockingIOError:
            return
        except OSError:
            data = b""
        if data:
            self.send(_answers(self._end, data))
        else:
            self._disconnect()

    def send(self, packets: Iterable[bytes]) -> None:
        """Also without a client: what is due now is not due again."""
        data = b"".join(packets)
        if self._client is None:
            return
        if len(self._waiting) < MOST_WAITING_BYTES:
            self._waiting += data
        if not self._waiting:
            return
        try:
            self._waiting = self._waiting[self._client.send(self._waiting) :]
        except BlockingIOError:
            return
        except OSError:
            self._disconnect()


@dataclass(frozen=True, slots=True)
class ServedStandIn:
    """One vehicle to be run: its file, its ports, and the file for its true states."""

    file: AutopilotFile
    ports: Ports
    truth: Path | None


def run_autopilots(stand_ins: Sequence[ServedStandIn], seconds: float | None) -> None:
    """Run until SIGTERM, SIGINT or `seconds` have passed. Raises ConfigError for a port in use or an unwritable file."""
    done = Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda _number, _frame: done.set())
    with ExitStack() as stack:
        selector = stack.enter_context(selectors.DefaultSelector())
        vehicles = [_Vehicle(stand_in, selector, stack) for stand_in in stand_ins]
        gc.collect()
        gc.freeze()  # objects made until now stay; the collector skips them in a step
        _fly(vehicles, selector, done, time.monotonic() + seconds if seconds is not None else float("inf"))
        for vehicle in vehicles:
            vehicle.flush()


class _Vehicle:
    """One stand-in with its open links and its truth file."""

    def __init__(self, stand_in: ServedStandIn, selector: selectors.BaseSelector, stack: ExitStack) -> None:
        """Raises ConfigError. `stack` closes what it opens."""
        file, ports, truth = stand_in.file, stand_in.ports, stand_in.truth
        behaviour = AUTOPILOT_TYPES[file.stand_in.autopilot]
        self._autopilot: Autopilot = behaviour.vehicle(file, DT_S)
        self._autopilot.flight_logs.utc_at_start_s = time.time()
        try:
            self._truth = stack.enter_context(truth.open("w", encoding="ascii")) if truth else None
        except OSError as error:
            raise ConfigError(f"--truth {truth}", "", f"{error.strerror}; name a file that can be written") from error
        if self._truth:
            self._truth.write(TRUTH_HEADER)
        self._links: list[tuple[LinkEnd, SocketLink]] = []
        for end, port, address in (
            (behaviour.onboard_link(self._autopilot), ports.onboard, (LOOPBACK, ports.companion)),
            (behaviour.ground_link(self._autopilot), ports.ground_link, (LOOPBACK, GROUND_STATION_PORT)),
        ):
            with _named_port("UDP", port):
                self._links.append((end, stack.enter_context(closing(UdpSocketLink(end, port, address, selector)))))
        where = f"UDP {ports.onboard} to {ports.companion}, ground station on {ports.ground_link}"
        if behaviour.tcp_link:
            end = behaviour.tcp_link(self._autopilot)
            with _named_port("TCP", ports.tcp):
                self._links.append((end, stack.enter_context(closing(TcpSocketLink(end, ports.tcp, selector)))))
            where = f"TCP {ports.tcp}, {where}"
        self._steps, self._id = 0, file.id
        self._cameras: socket.socket | None = None
        if file.truth_port:
            self._cameras = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            self._cameras.connect((LOOPBACK, file.truth_port))
            self._cameras.setblocking(False)
        print(f"vehicle {file.id}: MAVLink on {where}", flush=True)

    def step(self, now_s: float) -> None:
        autopilot = self._autopilot
        autopilot.step()
        autopilot.flight_logs.write(autopilot)
        self._steps += 1
        for end, link in self._links:
            link.send(end.due())
        autopilot.texts.clear()
        if self._truth and self._steps % TRUTH_STEPS == 0:
            quad, mode = autopilot.quad, autopilot.mode.name
            self._truth.write(truth_row(now_s, quad.state, quad.thrust_norm, autopilot.armed, mode))
        if self._cameras and self._steps % CAPTURE_STEPS == 0:
            with contextlib.suppress(OSError):  # no cameras yet, or no more
                self._cameras.send(truth_datagram(self._id, now_s, autopilot.quad.state))
        if self._steps % FLUSH_STEPS == 0:
            self.flush()

    def flush(self) -> None:
        if self._truth:
            self._truth.flush()


@contextlib.contextmanager
def _named_port(protocol: str, port: int) -> Iterator[None]:
    """Raises ConfigError instead of an OSError."""
    try:
        yield
    except OSError as error:
        raise ConfigError(f"{protocol} port {port}", "", f"{error.strerror}; {PORT_HINT}") from error


def _fly(vehicles: Sequence[_Vehicle], selector: selectors.BaseSelector, done: Event, end_s: float) -> None:
    """Step all whenever a step is due, in GROUPS after each other; after a late wake-up catch up by at most MAX_LAG_S.

    Vehicles do not step at the same moment, no more than real autopilots do: all their agents would want the processor at once.
    """
    groups = [vehicles[k::GROUPS] for k in range(min(GROUPS, len(vehicles)))]
    next_s, group = time.monotonic(), 0
    late = LateLoopLog(functools.partial(print, flush=True))
    while not done.is_set() and next_s < end_s:
        now_s = time.monotonic()
        late.cycle(next_s, now_s)
        next_s = max(next_s, now_s - MAX_LAG_S)
        for key, _ in selector.select(0):
            key.data()  # reads all that waits, and answers
        while next_s <= now_s:
            for vehicle in groups[group]:
                vehicle.step(next_s)
            group = (group + 1) % len(groups)
            next_s += DT_S / len(groups)
        time.sleep(max(0.0, next_s - time.monotonic()))
