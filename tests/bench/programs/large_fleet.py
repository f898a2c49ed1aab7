"""Processes of the large fleet: the measured link of one agent, the other vehicles, and a Zenoh router.

    python -m tests.bench.programs.large_fleet agent MODE LISTEN|CONNECT ENDPOINT NUMBER FULL
    python -m tests.bench.programs.large_fleet others MODE ENDPOINT NUMBER FULL
    python -m tests.bench.programs.large_fleet router ENDPOINT

The agent publishes and receives once a tick at 50 Hz. It prints `heard` when it has heard all NUMBER other vehicles, takes ages
from the first line of its input on, and prints the result as one line of JSON when its input ends. Each of the others has a
session of its own and publishes at 50 Hz on its key and at 5 Hz on its slow key, evenly one after the other; the first FULL of
them receive the agent at full rate. The router prints `ready`. All run until their input ends.

Keys, publishers and channels are those of the agent's `ZenohLink`. The slow key beside each of them is of this measurement
alone.
"""

from __future__ import annotations

import itertools
import json
import os
import sys
import time
from collections.abc import Collection, Sequence
from contextlib import ExitStack
from typing import Any

import msgspec
import zenoh
from msgspec.structs import replace

from companion.link.fleet.peer_states import samples_to_keep
from companion.link.fleet.zenoh_session import SETTINGS, THREADS, drain
from companion.link.tick import PERIOD_S
from companion.types.peers import PeerPacket
from companion.wire.keys import distant_key, peer_key
from companion.wire.messages import decode_peer, encode_peer
from tests.bench.figures import percentile
from tests.bench.programs.vehicle import Input, NewestStates, TickGrid, example_packet

FLEET = "large"
AGENT_ID = 1
TICKS_PER_SLOW = 10  # 5 Hz
SWITCHES = 20


class LinkResult(msgspec.Struct, frozen=True):
    """Ages at each tick of the newest states, in ms, and the time from declaring a subscriber to its first packet."""

    full_p50_ms: float
    full_p99_ms: float
    slow_worst_ms: float | None  # None where all are received at full rate
    packets_per_s: float
    switch_p50_ms: float | None
    switch_worst_ms: float | None


def opened(mode: str, listen: Sequence[str], connect: Sequence[str]) -> zenoh.Session:
    """A session with the agent's settings in another mode: a router forwards to clients, not to peers."""
    os.environ.setdefault("ZENOH_RUNTIME", THREADS)
    zenoh.init_log_from_env_or("off")
    config = zenoh.Config()
    settings: dict[str, Any] = {
        **SETTINGS,
        "mode": mode,
        "listen/endpoints": list(listen),
        "connect/endpoints": list(connect),
    }
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return zenoh.open(config)


class PeerLink:
    """Publishes the own state on both keys, and receives vehicles at full rate or a few times per second."""

    def __init__(
        self, own_id: int, session: zenoh.Session, full_ids: Collection[int], slow_ids: Collection[int]
    ) -> None:
        self._packet = example_packet(own_id)
        self._session = session
        self._sequence = 0
        self._full = session.declare_publisher(
            peer_key(FLEET, own_id),
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )
        self._slow = session.declare_publisher(
            distant_key(FLEET, own_id), congestion_control=zenoh.CongestionControl.DROP, priority=zenoh.Priority.DATA
        )
        self._samples_kept = samples_to_keep(1 + len({*full_ids, *slow_ids}))
        self._channels = [self.subscribed(peer_key(FLEET, i)) for i in full_ids]
        self._channels += [self.subscribed(distant_key(FLEET, i)) for i in slow_ids]

    def subscribed(self, key: str) -> Any:
        """A subscriber as the agent has one for each vehicle."""
        return self._session.declare_subscriber(
            key, zenoh.handlers.RingChannel(self._samples_kept), allowed_origin=zenoh.Locality.REMOTE
        )

    def publish(self, now_s: float, also_slow: bool) -> None:
        """The next packet, at full rate; on the slow key as well where it is its turn."""
        self._sequence += 1
        sender = replace(self._packet.sender, sequence=self._sequence)
        data = encode_peer(replace(self._packet, sender=sender, motion=replace(self._packet.motion, sent_s=now_s)))
        self._full.put(data)
        if also_slow:
            self._slow.put(data)

    def receive(self) -> list[PeerPacket]:
        """All packets since the last call."""
        return [
            decode_peer(sample.payload.to_bytes())
            for channel in self._channels
            for sample in drain(channel, self._samples_kept)
        ]


class Agent:
    """Ticks, and what was received."""

    def __init__(self, link: PeerLink, full_ids: range) -> None:
        self._link, self._full_ids = link, full_ids
        self._grid, self._newest = TickGrid(), NewestStates()
        self._ticks, self._packets = 0, 0
        self._began_s = time.monotonic()
        self._full_s: list[float] = []
        self._slow_s: list[float] = []

    @property
    def has_heard(self) -> int:
        """From how many vehicles."""
        return len(self._newest.sent_s)

    def tick(self) -> None:
        """Sends, receives, and notes the ages."""
        now_s = self._grid.wait()
        self._ticks += 1
        self._link.publish(now_s, self._ticks % TICKS_PER_SLOW == 0)
        packets = self._link.receive()
        self._packets += len(packets)
        self._newest.take(packets)
        for vehicle_id, sent_s in self._newest.sent_s.items():
            (self._full_s if vehicle_id in self._full_ids else self._slow_s).append(now_s - sent_s)

    def begin(self) -> None:
        """From now on ages and packets count."""
        self._full_s.clear()
        self._slow_s.clear()
        self._packets, self._began_s = 0, time.monotonic()

    def result(self, switches_s: list[float], lasted_s: float) -> LinkResult:
        return LinkResult(
            full_p50_ms=1e3 * percentile(self._full_s, 0.5),
            full_p99_ms=1e3 * percentile(self._full_s, 0.99),
            slow_worst_ms=1e3 * max(self._slow_s) if self._slow_s else None,
            packets_per_s=self._packets / lasted_s,
            switch_p50_ms=1e3 * percentile(switches_s, 0.5) if switches_s else None,
            switch_worst_ms=1e3 * max(switches_s) if switches_s else None,
        )

    @property
    def lasted_s(self) -> float:
        return time.monotonic() - self._began_s


def run_agent(mode: str, where: str, endpoint: str, *numbers: str) -> None:
    number, full = map(int, numbers)
    others = range(AGENT_ID + 1, AGENT_ID + 1 + number)
    talk = Input()
    listen, connect = ([endpoint], []) if where == "listen" else ([], [endpoint])
    with opened(mode, listen, connect) as session:
        link = PeerLink(AGENT_ID, session, others[:full], [] if full == number else others)
        agent = Agent(link, others[:full])
        while agent.has_heard < number:
            agent.tick()
        print("heard", flush=True)
        while not talk.begun.is_set():
            agent.tick()
        agent.begin()
        while not talk.ended.is_set():
            agent.tick()
        lasted_s = agent.lasted_s
        slow = others[full:]
        switches_s = [_switch_s(link, slow[n % len(slow)]) for n in range(SWITCHES)] if slow else []
        print(msgspec.json.encode(agent.result(switches_s, lasted_s)).decode(), flush=True)


def _switch_s(link: PeerLink, vehicle_id: int) -> float:
    """From declaring a subscriber at full rate to its first packet."""
    began_s = time.monotonic()
    channel = link.subscribed(peer_key(FLEET, vehicle_id))
    while channel.try_recv() is None:
        time.sleep(2e-4)
    passed_s = time.monotonic() - began_s
    channel.undeclare()
    return passed_s


def run_others(mode: str, endpoint: str, *numbers: str) -> None:
    number, full = map(int, numbers)
    talk = Input()
    with ExitStack() as stack:
        links = []
        for place in range(number):
            session = stack.enter_context(opened(mode, [], [endpoint]))
            slow = [] if full == number else [AGENT_ID]
            links.append(PeerLink(AGENT_ID + 1 + place, session, [AGENT_ID] if place < full else [], slow))
        _publish(links, talk)


def _publish(links: list[PeerLink], talk: Input) -> None:
    begin_s = time.monotonic()
    for tick in itertools.count():
        for place, link in enumerate(links):
            due_s = begin_s + (tick + place / len(links)) * PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            link.publish(time.monotonic(), (tick + place) % TICKS_PER_SLOW == 0)
        if talk.ended.is_set():
            return


def run_router(endpoint: str) -> None:
    with opened("router", [endpoint], []):
        print("ready", flush=True)
        sys.stdin.read()


if __name__ == "__main__":
    match sys.argv[1]:
        case "agent":
            run_agent(*sys.argv[2:])
        case "others":
            run_others(*sys.argv[2:])
        case "router":
            run_router(*sys.argv[2:])
