"""The other vehicles of one agent: python -m tests.bench.programs.large_fleet_others MODE ENDPOINT NUMBER FULL.

Each has a session of its own and publishes at 50 Hz on its key and at 5 Hz on its slow key, evenly one after the other. The
first FULL of them receive the agent at full rate. All run until the input ends.
"""

from __future__ import annotations

import itertools
import sys
import threading
import time
from contextlib import ExitStack

from companion.link.tick import PERIOD_S
from tests.bench.programs.large_fleet_agent import AGENT_ID, TICKS_PER_SLOW
from tests.bench.programs.large_fleet_link import PeerLink, opened


def main() -> None:
    mode, endpoint, number, full = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    ended = threading.Event()
    threading.Thread(target=_wait_for_end, args=(ended,), daemon=True).start()
    with ExitStack() as stack:
        links = []
        for place in range(number):
            session = stack.enter_context(opened(mode, [], [endpoint]))
            at_full_rate = place < full
            agent = [AGENT_ID]
            slow = [] if full == number else agent
            links.append(PeerLink(AGENT_ID + 1 + place, session, agent if at_full_rate else [], slow))
        _publish(links, ended)


def _publish(links: list[PeerLink], ended: threading.Event) -> None:
    begin_s = time.monotonic()
    for tick in itertools.count():
        for place, link in enumerate(links):
            due_s = begin_s + (tick + place / len(links)) * PERIOD_S
            time.sleep(max(0.0, due_s - time.monotonic()))
            link.publish(time.monotonic(), (tick + place) % TICKS_PER_SLOW == 0)
        if ended.is_set():
            return


def _wait_for_end(ended: threading.Event) -> None:
    sys.stdin.read()
    ended.set()


if __name__ == "__main__":
    main()
