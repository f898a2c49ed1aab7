"""One vehicle's network links without its flight: publishes at 50 Hz and measures the age of the others' states.

    python -m tests.bench.programs.transport_vehicle VEHICLE_FILE SECONDS

It prints `heard` when every other vehicle was heard, measures from the next line of its input on, prints the result as one line
of JSON, and publishes until its input ends.
"""

from __future__ import annotations

import os
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import numpy as np
from msgspec.structs import replace

from companion.config.vehicle import AgentConfig, load_agent
from companion.link.fleet.identity import vehicle_identity
from companion.link.fleet.peer_datagrams import DatagramSeal, PeerDatagrams
from companion.link.fleet.zenoh_link import ZenohLink
from tests.bench.programs.vehicle import Input, NewestStates, TickGrid, example_packet, ignore_refused


class TransportAges(msgspec.Struct, frozen=True):
    """Ages in milliseconds of the newest state of each peer, at every tick; share of a core."""

    median_ms: float
    p99_ms: float
    worst_ms: float
    too_old: float  # share of the ticks in which the state of a peer was older than peers.max_age_s
    cpu: float


def main(file: Path, seconds: float) -> None:
    config = load_agent(file)
    talk = Input()
    with ExitStack() as stack:
        vehicle = _LinkedVehicle(_link(file, config, stack), config)
        while not vehicle.has_heard_all:
            vehicle.tick()
        print("heard", flush=True)
        while not talk.begun.is_set():
            vehicle.tick()
        print(msgspec.json.encode(vehicle.measure(seconds)).decode(), flush=True)
        while not talk.ended.is_set():
            vehicle.tick()


def _link(file: Path, config: AgentConfig, stack: ExitStack) -> ZenohLink:
    """The links as the agent opens them."""
    identity = vehicle_identity(file, config) if config.vehicle.identity else None
    datagrams = None
    if config.datagrams:
        ids = [member.id for member in config.fleet.vehicles]
        seal = DatagramSeal(config.vehicle.id, ids) if identity else None
        datagrams = stack.enter_context(closing(PeerDatagrams(config.datagrams, config.fleet, ignore_refused, seal)))
    link = ZenohLink(config.vehicle.id, config.fleet, config.zenoh, ignore_refused, datagrams, identity)
    return stack.enter_context(closing(link))


class _LinkedVehicle:
    """Publishes and receives once a tick."""

    def __init__(self, link: ZenohLink, config: AgentConfig) -> None:
        self._link, self._max_age_s = link, config.fleet.peers.max_age_s
        self._packet = example_packet(config.vehicle.id)
        self._grid, self._newest = TickGrid(1e-3 * config.vehicle.id), NewestStates()
        self._others = {member.id for member in config.fleet.vehicles} - {config.vehicle.id}

    @property
    def has_heard_all(self) -> bool:
        return self._others <= self._newest.sent_s.keys()

    def tick(self) -> float:
        """The time of this tick."""
        now_s = self._grid.wait()
        sender, motion = self._packet.sender, self._packet.motion
        self._packet = replace(
            self._packet, sender=replace(sender, sequence=sender.sequence + 1), motion=replace(motion, sent_s=now_s)
        )
        self._link.publish_peer(self._packet)
        packets, _ = self._link.receive(now_s)
        self._newest.take(received.packet for received in packets)
        return now_s

    def measure(self, seconds: float) -> TransportAges:
        """Over this time from now on."""
        ages_s: list[float] = []
        began, end_s = os.times(), time.monotonic() + seconds
        while (now_s := self.tick()) < end_s:
            ages_s += self._newest.ages_s(now_s)
        ended = os.times()
        median, p99, worst = np.quantile(ages_s, (0.5, 0.99, 1.0)) * 1e3
        used_s = ended.user + ended.system - began.user - began.system
        return TransportAges(
            median_ms=float(median),
            p99_ms=float(p99),
            worst_ms=float(worst),
            too_old=float(np.mean(np.array(ages_s) > self._max_age_s)),
            cpu=used_s / (ended.elapsed - began.elapsed),
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
