"""sitl.network for many formations: which packet is the newest on each way, where some are lost or come late by chance."""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil

import numpy as np

from companion.core.arrays import FloatArray
from sitl.autopilot import DT_S
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.batch.noise import LINKS
from sitl.scenario import Scenario
from sitl.world import TELEMETRY_STEPS

PERIOD_S = DT_S * TELEMETRY_STEPS
ROUND_TICKS = 1e-6  # a delay of whole steps is one


class Arrivals:
    """Ways are (B n, K), receiver by candidate. Ticks are counted from 0; what was sent before came in time."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, valid: BoolArray, ticks_late: FloatArray
    ) -> None:
        """`ticks_late` (B n, K): how long after the receiver's tick of its own number a packet comes that has no jitter."""
        links = [scenario.links for scenario in scenarios]
        self._columns = columns
        self._ticks_late = ticks_late
        lag = first_heard(ticks_late)
        self._loss = columns.spread([link.peer_loss for link in links])[:, None]
        self._jitter = columns.spread([link.peer_jitter_s / PERIOD_S for link in links])[:, None]
        self._shortest, self._longest = int(lag.min()), int(lag.max()) + ceil(float(self._jitter.max()))
        self._most_age = columns.spread([s.fleet.peers.max_age_s / PERIOD_S for s in scenarios])[:, None]
        self._late = np.broadcast_to(ticks_late, (self._longest + 1, *ticks_late.shape)).copy()
        self._newest = -lag - 1
        self._drawn = -1
        widths = valid.sum(axis=1)[columns.column_of].reshape(columns.formations, columns.vehicles).max(axis=1)
        self._widths: list[int] = widths.tolist()  # a formation draws as many whatever else is in the batch
        chancy = [link.peer_loss > 0.0 or link.peer_jitter_s > 0.0 for link in links]
        self._generators = [
            np.random.default_rng([s.stand_in.seed, LINKS]) if by_chance else None
            for s, by_chance in zip(scenarios, chancy, strict=True)
        ]

    def hear(self, tick: int, group: slice) -> IntArray:
        """For each way (G, K): the tick in which its newest packet was sent."""
        if tick > self._drawn:
            self._draw(tick)
        newest = self._newest[group]
        for sent in range(tick - self._longest, tick - self._shortest + 1):
            there = self._late[sent % len(self._late), group] < tick - sent - ROUND_TICKS
            there &= newest < sent
            np.copyto(newest, sent, where=there)
        return newest

    def fresh(self, ages_ticks: IntArray, group: slice) -> BoolArray:
        """Is what has this age still believed?"""
        return np.asarray(ages_ticks <= self._most_age[group] + ROUND_TICKS)

    def _draw(self, tick: int) -> None:
        """How all packets of this tick will fare."""
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


def first_heard(ticks_late: FloatArray) -> IntArray:
    """In how many ticks a packet is heard that comes this late: in the first one that is truly later."""
    return np.asarray(np.floor(ticks_late + ROUND_TICKS).astype(np.int64) + 1)
