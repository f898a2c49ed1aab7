"""What the vehicles tell each other, and what each has heard of it: companion.core.peers in arrays.

Times are exact, as in lockstep: a packet counts at its receiver's first tick after its arrival, and is carried on from the
tick in which it would have counted without jitter; in lockstep a while of hovering has shown how early that is. The peers'
checks of plausibility are left out: one that flies faster than `max_speed_m_s` is heeded all the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from companion.core.arrays import FloatArray
from sitl.batch.arrivals import PERIOD_S, Arrivals, first_heard
from sitl.batch.candidates import Candidates
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.scenario import Scenario
from sitl.world import TELEMETRY_STEPS

# Of a packet: the position less its slot [m], velocity [m/s], acceleration command [m/s^2], PrC and what it is worth.
PLACE, VELOCITY, ACCELERATION, PRC, SHARE, WIDTH = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, 11


@dataclass(frozen=True, slots=True)
class Heard:
    """The newest packets that a group of vehicles has of its candidates, as places (G, K) in the ring; which still count.

    `age_s` (G, K) is what a packet is older than one that comes with no jitter, in this tick; None where none is.
    """

    places: IntArray
    fresh: BoolArray
    age_s: FloatArray | None

    def only(self, members: BoolArray) -> Heard:
        """Of these alone, as few to a row as there are. Who is in range is a tenth of those who could be."""
        receiver, candidate = np.nonzero(members)
        counts = members.sum(axis=1)
        first = np.cumsum(counts) - counts
        shape = (len(counts), max(1, int(counts.max())))
        at = (receiver, np.arange(receiver.size) - first[receiver])
        places, fresh = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.bool_)
        places[at], fresh[at] = self.places[receiver, candidate], True
        if self.age_s is None:
            return Heard(places, fresh, None)
        age_s = np.zeros(shape)
        age_s[at] = self.age_s[receiver, candidate]
        return Heard(places, fresh, age_s)


class Packets:
    """A ring of all packets that may still matter. Ticks are counted from 0; before that everybody told its start."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, candidates: Candidates, start: FloatArray
    ) -> None:
        """`start` (WIDTH, B n) is what everybody tells before the first tick."""
        self._count = columns.count
        self._valid, self._sender = candidates.valid, candidates.sender
        delay = columns.spread([scenario.links.peer_delay_s / PERIOD_S for scenario in scenarios])[:, None]
        phase = columns.phase_steps / TELEMETRY_STEPS
        ticks_late = phase[candidates.sender] - phase[:, None] + delay
        self._lag = lag = first_heard(ticks_late)
        jitter_s = max(scenario.links.peer_jitter_s for scenario in scenarios)
        by_chance = jitter_s > 0.0 or any(scenario.links.peer_loss > 0.0 for scenario in scenarios)
        self._arrivals = Arrivals(scenarios, columns, candidates.valid, ticks_late) if by_chance else None
        oldest_s = max(scenario.fleet.peers.max_age_s for scenario in scenarios) + jitter_s if by_chance else 0.0
        self._kept = int(lag.max()) + ceil(oldest_s / PERIOD_S) + 3
        self._ring = np.broadcast_to(start.T, (self._kept, columns.count, WIDTH)).reshape(-1, WIDTH).copy()
        self._motions = self._ring[:, :6].copy()  # the same, of which range decides
        self._place = (-lag % self._kept) * columns.count + candidates.sender

    def send(self, tick: int, group: slice, packets: FloatArray) -> None:
        """`packets` (WIDTH, G) of these columns."""
        begin = tick % self._kept * self._count
        self._ring[begin + group.start : begin + group.stop] = packets.T
        self._motions[begin + group.start : begin + group.stop] = packets[:6].T

    def hear(self, tick: int, group: slice) -> Heard:
        if self._arrivals is None:
            places = self._place[group] + tick % self._kept * self._count
            return Heard(places, self._valid[group], None)
        newest = self._arrivals.hear(tick, group)
        ages_ticks = tick - newest - self._lag[group]
        places = newest % self._kept * self._count + self._sender[group]
        fresh = self._arrivals.fresh(ages_ticks, group) & self._valid[group]
        return Heard(places, fresh, np.multiply(ages_ticks, PERIOD_S, dtype=np.float64))

    def packets(self, heard: Heard) -> FloatArray:
        """(G, K, WIDTH)."""
        return self._ring.take(heard.places, axis=0, mode="wrap")

    def places_now_enu_m(self, heard: Heard) -> FloatArray:
        """Positions less their slots (G, K, 3), carried on to now."""
        motions = self._motions.take(heard.places, axis=0, mode="wrap")
        if heard.age_s is not None:
            motions[:, :, :3] += motions[:, :, 3:] * heard.age_s[:, :, None]
        return motions[:, :, :3]
