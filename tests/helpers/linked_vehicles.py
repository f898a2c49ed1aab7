"""Vehicles in formation with the real Zenoh links of their agents: they report, and answer commands as a test wants."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field

from companion.config.vehicle import ZenohEndpoints
from companion.link.fleet.zenoh_link import ZenohLink
from companion.types.commands import Command, CommandReply
from companion.types.notices import Code
from tests.bench.monitor_load import SteadyFleet, steady_fleet

PERIOD_S = 0.05
Answer = Callable[[int, Command], CommandReply | None]
"""Vehicle id and command -> its reply; None: no reply."""


def accept(vehicle_id: int, command: Command) -> CommandReply:
    return CommandReply(vehicle_id, command.number, True, Code.PHASE_CHANGED, "done", command.operator)


@dataclass
class LinkedVehicles:
    load: SteadyFleet
    endpoints: tuple[str, ...]
    answer: Answer = accept
    commands: list[tuple[int, Command]] = field(default_factory=list)  # each once
    silent: set[int] = field(default_factory=set)  # ids that do not report

    def received(self, name: str) -> list[int]:
        """The vehicles that have received a command of this name."""
        return sorted({i for i, command in self.commands if command.name == name})

    def run(self, links: dict[int, ZenohLink], stopped: threading.Event) -> None:
        begin_s = time.monotonic()
        while not stopped.wait(PERIOD_S):
            for vehicle_id, link in links.items():
                now_s = time.monotonic()
                if vehicle_id not in self.silent:
                    link.publish_status(self.load.report(vehicle_id, now_s - begin_s))
                for command in link.receive(now_s)[1]:
                    if (vehicle_id, command) not in self.commands:
                        self.commands.append((vehicle_id, command))
                    reply = self.answer(vehicle_id, command)
                    link.reply([reply] if reply else [])


@contextmanager
def linked_vehicles(count: int = 3) -> Iterator[LinkedVehicles]:
    """Vehicles 1 to `count` of fleet "load", each on a port of its own."""
    load = steady_fleet("load", count)
    with ExitStack() as stack:
        links, endpoints = {}, []
        for vehicle_id in load.vehicle_ids:
            endpoint = f"tcp/127.0.0.1:{_free_port()}"
            used = ZenohEndpoints(listen=(endpoint,), connect=())
            links[vehicle_id] = stack.enter_context(closing(ZenohLink(vehicle_id, load.fleet, used, lambda _key: None)))
            endpoints.append(endpoint)
        vehicles, stopped = LinkedVehicles(load, tuple(endpoints)), threading.Event()
        thread = threading.Thread(target=vehicles.run, args=(links, stopped), daemon=True)
        thread.start()
        try:
            yield vehicles
        finally:
            stopped.set()
            thread.join()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
