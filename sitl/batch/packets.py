"""What the vehicles tell each other, and which of it has reached whom: sitl.network and companion.core.peers in arrays.

Times are exact, as in lockstep: a packet counts at its receiver's first tick after its arrival, and is carried on from
there. The peers' checks of plausibility are left out; nothing here sends what they refuse.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from sitl.batch.candidates import Candidates
from sitl.batch.columns import BoolArray, Columns
from sitl.px4 import DT_S
from sitl.scenario import Scenario
from sitl.tracks import FloatArray
from sitl.world import TELEMETRY_STEPS

# Of a packet: the position less its slot [m], velocity [m/s], acceleration command [m/s^2], PrC and what it is worth.
PLACE, VELOCITY, ACCELERATION, PRC, SHARE, WIDTH = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, 11
ROUND_STEPS = 1e-6  # a delay of whole steps is one


@dataclass(frozen=True, slots=True)
class Heard:
    """The newest packets (G, K, WIDTH) that a group of vehicles has of its candidates, which of them still count, and
    their ages [s] since receipt; None where all came in this tick."""

    packets: FloatArray
    fresh: BoolArray
    age_s: FloatArray | None


class Packets:
    """A ring of all packets that may still matter. Ticks are counted from 0; before that everybody told its start."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, candidates: Candidates, start: FloatArray
    ) -> None:
        """`start` (WIDTH, B n) is what everybody tells before the first tick."""
        self._columns = columns
        self._valid = candidates.valid
        delay = columns.spread([s.links.peer_delay_s / DT_S for s in scenarios])
        first_step = (columns.phase_steps[candidates.sender] - columns.phase_steps[:, None]) + delay[:, None]
        # Sent in tick k, a packet without jitter is heard in tick k + lag.
        self._lag = np.floor(first_step / TELEMETRY_STEPS + ROUND_STEPS).astype(np.int64) + 1
        longest_age_s = max(s.fleet.peers.max_age_s for s in scenarios)
        jitter = max(s.links.peer_jitter_s for s in scenarios)
        longest = int(self._lag.max()) + ceil(jitter / (DT_S * TELEMETRY_STEPS))
        self._perfect = jitter == 0.0 and all(s.links.peer_loss == 0.0 for s in scenarios)
        kept = longest + 2 + (0 if self._perfect else ceil(longest_age_s / (DT_S * TELEMETRY_STEPS)))
        self._ring = np.ascontiguousarray(np.broadcast_to(start.T, (kept, columns.count, WIDTH))).reshape(-1, WIDTH)
        self._kept = kept
        self._place = (-self._lag % kept) * columns.count + candidates.sender
        self._sender = candidates.sender

    def send(self, tick: int, group: slice, packets: FloatArray) -> None:
        """`packets` (WIDTH, G) of these columns."""
        begin = tick % self._kept * self._columns.count
        self._ring[begin + group.start : begin + group.stop] = packets.T

    def hear(self, tick: int, group: slice) -> Heard:
        count = self._columns.count
        places = self._place[group] + tick % self._kept * count
        return Heard(self._ring.take(places, axis=0, mode="wrap"), self._valid[group], None)
