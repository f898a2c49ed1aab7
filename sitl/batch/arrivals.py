"""`sitl.links.network` for many formations: the newest packet on each link, with random loss and delay."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.autopilots.autopilot import DT_S
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.batch.noise import LINKS
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario

PERIOD_S = DT_S * TELEMETRY_STEPS
ROUND_TICKS = 1e-6  # tolerance within which a delay counts as whole steps


class LinkArrivals:
    """Arrival times on all links (B n, K), receiver by candidate. Ticks count from 0; earlier packets arrived in time."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, valid: BoolArray, ticks_late: FloatArray
    ) -> None:
        """`ticks_late` (B n, K): delay of a packet without jitter after the receiver's tick of the same number."""
        links = [scenario.links for scenario in scenarios]
        self._columns = columns
        self._ticks_late = ticks_late
        lag = ticks_until_use(ticks_late)
        self._loss = columns.spread([link.peer_loss for link in links])[:, None]
        self._jitter = columns.spread([link.peer_jitter_s / PERIOD_S for link in links])[:, None]
        self._shortest, self._longest = int(lag.min()), int(lag.max()) + ceil(float(self._jitter.max()))
        self._most_age = columns.spread([s.fleet.peers.max_age_s / PERIOD_S for s in scenarios])[:, None]
        self._late = np.broadcast_to(ticks_late, (self._longest + 1, *ticks_late.shape)).copy()
        self._newest = -lag - 1
        self._drawn = -1
        widths = valid.sum(axis=1)[columns.column_of].reshape(columns.formations, columns.vehicles).max(axis=1)
        self._widths: list[int] = widths.tolist()  # a formation draws as many numbers in any batch
        is_random = [link.peer_loss > 0.0 or link.peer_jitter_s > 0.0 for link in links]
        self._generators = [
            np.random.default_rng([s.stand_in.seed, LINKS]) if random else None
            for s, random in zip(scenarios, is_random, strict=True)
        ]

    def newest(self, tick: int, group: slice) -> IntArray:
        """For each link (G, K): the tick in which its newest packet was sent."""
        if tick > self._drawn:
            self._draw(tick)
        newest = self._newest[group]
        for sent in range(tick - self._longest, tick - self._shortest + 1):
            arrived = self._late[sent % len(self._late), group] < tick - sent - ROUND_TICKS
            arrived &= newest < sent
            np.copyto(newest, sent, where=arrived)
        return newest

    def fresh(self, ages_ticks: IntArray, group: slice) -> BoolArray:
        """Whether packets of these ages are still used (G, K)."""
        return np.asarray(ages_ticks <= self._most_age[group] + ROUND_TICKS)

    def _draw(self, tick: int) -> None:
        """Draw loss and delay of all packets of this tick."""
        n, widest = self._columns.vehicles, self._ticks_late.shape[1]
        chances = np.ones((2, self._columns.formations, n, widest))
        for b, generator in enumerate(self._generators):
            if generator is not None:
                chances[:, b, :, : self._widths[b]] = generator.random((2, n, self._widths[b]))
        chances = chances.reshape(2, -1, widest).take(self._columns.order, axis=1)
        late = self._ticks_late + self._jitter * chances[1]
        late[chances[0] < self._loss] = np.inf
        self._late[tick % len(self._late)] = late
        self._drawn = tick


def ticks_until_use(ticks_late: FloatArray) -> IntArray:
    """Ticks from the sending to the first use of a packet with this delay: the first tick after its arrival."""
    return np.asarray(np.floor(ticks_late + ROUND_TICKS).astype(np.int64) + 1)
