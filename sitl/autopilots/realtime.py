"""Stand-in autopilots behind sockets, in real time: any number of them in one process, in one loop."""

from __future__ import annotations

import contextlib
import functools
import gc
import selectors
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from threading import Event

from companion.config.file import ConfigError
from companion.link.tick import LateLoopLog
from sitl.autopilots.autopilot import DT_S, Autopilot
from sitl.autopilots.behaviour import AUTOPILOT_TYPES
from sitl.links.ports import GROUND_STATION_PORT, LOOPBACK, Ports
from sitl.links.sockets import SocketLink, TcpSocketLink, UdpSocketLink, receive_waiting
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.truth import TRUTH_HEADER, truth_row

MAX_LAG_S = 0.5  # longer pauses of the machine are skipped
TRUTH_STEPS, FLUSH_STEPS = 5, 250
GROUPS = 4  # of vehicles, 1 ms after each other
PORT_HINT = "stop what uses the port, or move all ports with --port-offset"


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
        self._links: list[SocketLink] = []
        for end, port, address in (
            (behaviour.onboard_link(self._autopilot), ports.onboard, (LOOPBACK, ports.companion)),
            (behaviour.ground_link(self._autopilot), ports.ground_link, (LOOPBACK, GROUND_STATION_PORT)),
        ):
            with _named_port("UDP", port):
                self._links.append(stack.enter_context(closing(UdpSocketLink(end, port, address, selector))))
        where = f"UDP {ports.onboard} to {ports.companion}, ground station on {ports.ground_link}"
        if behaviour.tcp_link:
            with _named_port("TCP", ports.tcp):
                tcp = TcpSocketLink(behaviour.tcp_link(self._autopilot), ports.tcp, selector)
            self._links.append(stack.enter_context(closing(tcp)))
            where = f"TCP {ports.tcp}, {where}"
        self._steps = 0
        print(f"vehicle {file.id}: MAVLink on {where}", flush=True)

    def step(self, now_s: float) -> None:
        autopilot = self._autopilot
        autopilot.step()
        autopilot.flight_logs.write(autopilot)
        self._steps += 1
        for link in self._links:
            link.send_due()
        autopilot.texts.clear()
        if self._truth and self._steps % TRUTH_STEPS == 0:
            quad, mode = autopilot.quad, autopilot.flight_mode.name
            self._truth.write(truth_row(now_s, quad.state, quad.thrust_norm, autopilot.armed, mode))
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
        receive_waiting(selector)
        while next_s <= now_s:
            for vehicle in groups[group]:
                vehicle.step(next_s)
            group = (group + 1) % len(groups)
            next_s += DT_S / len(groups)
        time.sleep(max(0.0, next_s - time.monotonic()))
