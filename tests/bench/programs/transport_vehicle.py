"""One vehicle's network links without its flight: publishes at 50 Hz and measures the age of the others' states.

    python -m tests.bench.programs.transport_vehicle VEHICLE_FILE SECONDS

It prints `heard` when every other vehicle was heard, measures from the next line of its input on, prints the result as one line
of JSON, and publishes until its input ends.
"""

from __future__ import annotations

import os
import sys
import threading
import time
from contextlib import ExitStack, closing
from pathlib import Path

import msgspec
import numpy as np

from companion.config.vehicle import AgentConfig, load_agent
from companion.link.fleet.identity import vehicle_identity
from companion.link.fleet.peer_datagrams import DatagramSeal, PeerDatagrams
from companion.link.fleet.zenoh_link import ZenohLink
from companion.link.tick import PERIOD_S
from companion.types.flight import FlightPhase
from companion.types.formation import FlownSlot, LeaderBeacon
from companion.types.peers import PeerPacket
from companion.types.values import ZERO3


class Measured(msgspec.Struct, frozen=True):
    """Ages in milliseconds of the newest state of each peer, at every tick; share of a core."""

    median_ms: float
    p99_ms: float
    worst_ms: float
    too_old: float  # share of the ticks in which the state of a peer was older than peers.max_age_s
    cpu: float


def main(file: Path, seconds: float) -> None:
    config = load_agent(file)
    go = threading.Event()
    threading.Thread(target=_read_input, args=(go,), daemon=True).start()
    with ExitStack() as stack:
        link = _link(file, config, stack)
        peers = {member.id for member in config.fleet.vehicles} - {config.vehicle.id}
        vehicle = _Vehicle(link, config)
        while not peers <= vehicle.newest_s.keys():
            vehicle.tick()
        print("heard", flush=True)
        while not go.is_set():
            vehicle.tick()
        print(msgspec.json.encode(vehicle.measure(seconds)).decode(), flush=True)
        go.clear()
        while not go.is_set():
            vehicle.tick()


def _read_input(go: threading.Event) -> None:
    """Each line, and the end of the input."""
    for _ in sys.stdin:
        go.set()
    go.set()


def _link(file: Path, config: AgentConfig, stack: ExitStack) -> ZenohLink:
    """The links as the agent opens them."""
    identity = vehicle_identity(file, config) if config.vehicle.identity else None
    datagrams = None
    if config.datagrams:
        ids = [member.id for member in config.fleet.vehicles]
        seal = DatagramSeal(config.vehicle.id, ids) if identity else None
        datagrams = stack.enter_context(closing(PeerDatagrams(config.datagrams, config.fleet, _ignore, seal)))
    link = ZenohLink(config.vehicle.id, config.fleet, config.zenoh, _ignore, datagrams, identity)
    return stack.enter_context(closing(link))


def _ignore(_rejected: str) -> None:
    """A refused packet shows in the age."""


def example_packet(config: AgentConfig) -> PeerPacket:
    """A packet in formation, of the usual size."""
    return PeerPacket(
        vehicle_id=config.vehicle.id,
        session=os.getpid(),
        sequence=0,
        formation_hash=1,
        phase=FlightPhase.FORMATION,
        role=config.member.role,
        position_enu_m=(1.5, 2.5, 10.5),
        velocity_enu_m_s=(0.5, 0.5, 0.5),
        acceleration_enu_m_s2=ZERO3,
        state_age_s=0.01,
        sent_s=0.0,
        prc=2,
        leader_beacon=LeaderBeacon(1, 1, 1),
        slot=FlownSlot(ZERO3),
    )


class _Vehicle:
    """Publishes and receives once a tick, on a fixed grid of time."""

    def __init__(self, link: ZenohLink, config: AgentConfig) -> None:
        self._link, self._max_age_s = link, config.fleet.peers.max_age_s
        self._packet = example_packet(config)
        # A little different for each vehicle: in 20 s the ticks of two vehicles pass each other, and no result depends on luck.
        self._period_s = PERIOD_S * (1.0 + 1e-3 * config.vehicle.id)
        self._due_s = time.monotonic()
        self.newest_s: dict[int, float] = {}  # time of sending by sender: one machine has one clock

    def tick(self) -> float:
        """The time of this tick."""
        self._due_s += self._period_s
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        now_s = time.monotonic()
        self._packet = msgspec.structs.replace(self._packet, sequence=self._packet.sequence + 1, sent_s=now_s)
        self._link.publish_peer(self._packet)
        packets, _ = self._link.receive(now_s)
        for received in packets:
            sender, sent_s = received.packet.vehicle_id, received.packet.sent_s
            self.newest_s[sender] = max(sent_s, self.newest_s.get(sender, sent_s))
        return now_s

    def measure(self, seconds: float) -> Measured:
        """Over this time from now on."""
        ages_s: list[float] = []
        began, end_s = os.times(), time.monotonic() + seconds
        while (now_s := self.tick()) < end_s:
            ages_s += [now_s - sent_s for sent_s in self.newest_s.values()]
        ended = os.times()
        median, p99, worst = np.quantile(ages_s, (0.5, 0.99, 1.0)) * 1e3
        used_s = ended.user + ended.system - began.user - began.system
        return Measured(
            median_ms=float(median),
            p99_ms=float(p99),
            worst_ms=float(worst),
            too_old=float(np.mean(np.array(ages_s) > self._max_age_s)),
            cpu=used_s / (ended.elapsed - began.elapsed),
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), float(sys.argv[2]))
