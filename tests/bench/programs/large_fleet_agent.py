"""The measured link of one agent: python -m tests.bench.programs.large_fleet_agent MODE LISTEN|CONNECT ENDPOINT NUMBER FULL.

It publishes and receives once a tick at 50 Hz. It prints `heard` when it has heard all NUMBER other vehicles, takes ages from
the first line of its input on, and prints the result as one line of JSON when its input ends.
"""

from __future__ import annotations

import sys
import threading
import time

import msgspec

from companion.link.tick import PERIOD_S
from companion.wire.keys import peer_key
from tests.bench.figures import percentile
from tests.bench.programs.large_fleet_link import FLEET, PeerLink, opened

AGENT_ID = 1
TICKS_PER_SLOW = 10  # 5 Hz
SWITCHES = 20


class Result(msgspec.Struct, frozen=True):
    """Ages at each tick of the newest states, in ms, and the time from declaring a subscriber to its first packet."""

    full_p50_ms: float
    full_p99_ms: float
    slow_worst_ms: float | None  # None where all are received at full rate
    packets_per_s: float
    switch_p50_ms: float | None
    switch_worst_ms: float | None


class Agent:
    """Ticks, and what was received."""

    def __init__(self, link: PeerLink, full_ids: range) -> None:
        self._link, self._full_ids = link, full_ids
        self._ticks, self._packets = 0, 0
        self._due_s = self._began_s = time.monotonic()
        self._full_s: list[float] = []
        self._slow_s: list[float] = []
        self.newest_s: dict[int, float] = {}  # time of sending by sender: one machine has one clock

    def tick(self) -> None:
        """Sends, receives, and notes the ages."""
        self._due_s += PERIOD_S
        time.sleep(max(0.0, self._due_s - time.monotonic()))
        self._ticks += 1
        now_s = time.monotonic()
        self._link.publish(now_s, self._ticks % TICKS_PER_SLOW == 0)
        for packet in self._link.receive():
            self._packets += 1
            self.newest_s[packet.vehicle_id] = max(packet.sent_s, self.newest_s.get(packet.vehicle_id, 0.0))
        for vehicle_id, sent_s in self.newest_s.items():
            (self._full_s if vehicle_id in self._full_ids else self._slow_s).append(now_s - sent_s)

    def begin(self) -> None:
        """From now on ages and packets count."""
        self._full_s.clear()
        self._slow_s.clear()
        self._packets, self._began_s = 0, time.monotonic()

    def result(self, switches_s: list[float], lasted_s: float) -> Result:
        return Result(
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


def main() -> None:
    mode, where, endpoint = sys.argv[1:4]
    number, full = int(sys.argv[4]), int(sys.argv[5])
    others = range(AGENT_ID + 1, AGENT_ID + 1 + number)
    begun, ended = threading.Event(), threading.Event()
    threading.Thread(target=_read_input, args=(begun, ended), daemon=True).start()
    listen, connect = ([endpoint], []) if where == "listen" else ([], [endpoint])
    with opened(mode, listen, connect) as session:
        link = PeerLink(AGENT_ID, session, others[:full], [] if full == number else others)
        agent = Agent(link, others[:full])
        while len(agent.newest_s) < number:
            agent.tick()
        print("heard", flush=True)
        while not begun.is_set():
            agent.tick()
        agent.begin()
        while not ended.is_set():
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


def _read_input(begun: threading.Event, ended: threading.Event) -> None:
    sys.stdin.readline()
    begun.set()
    sys.stdin.read()
    ended.set()


if __name__ == "__main__":
    main()
