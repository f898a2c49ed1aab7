"""Peer packets sent and received by all vehicles: companion.core.consensus.peers in arrays.

Times are exact, as in lockstep: a packet is used from its receiver's first tick after its arrival. It is extrapolated from the
tick of its first use without jitter; in lockstep the agents measure that delay while they hover. Plausibility checks of peers
are left out: a peer faster than `max_speed_m_s` is used too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from companion.stability.arrays import FloatArray
from sitl.batch.arrivals import PERIOD_S, LinkArrivals, ticks_until_use
from sitl.batch.candidates import Candidates
from sitl.batch.columns import BoolArray, Columns, IntArray
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario

# Fields of a packet: position minus slot [m], velocity [m/s], acceleration command [m/s^2], PrC, and p^-alpha.
REDUCED_POSITION, VELOCITY, ACCELERATION, PRC, SHARE, WIDTH = slice(0, 3), slice(3, 6), slice(6, 9), 9, 10, 11


@dataclass(frozen=True, slots=True)
class ReceivedPackets:
    """The newest packets of a group from its candidates, as indices (G, K) into the ring; `fresh` (G, K) marks those in use.

    `age_s` (G, K) is the age of a packet beyond that of one without jitter; None where no link is random.
    """

    indices: IntArray
    fresh: BoolArray
    age_s: FloatArray | None

    def only(self, members: BoolArray) -> ReceivedPackets:
        """The packets of `members` (G, K) alone, in as short rows as possible: a tenth of the candidates are in range."""
        receiver, candidate = np.nonzero(members)
        counts = members.sum(axis=1)
        first = np.cumsum(counts) - counts
        shape = (len(counts), max(1, int(counts.max())))
        at = (receiver, np.arange(receiver.size) - first[receiver])
        indices, fresh = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.bool_)
        indices[at], fresh[at] = self.indices[receiver, candidate], True
        if self.age_s is None:
            return ReceivedPackets(indices, fresh, None)
        age_s = np.zeros(shape)
        age_s[at] = self.age_s[receiver, candidate]
        return ReceivedPackets(indices, fresh, age_s)


class Packets:
    """A ring of all packets that may still be used. Ticks count from 0; before that every vehicle sent its start."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, candidates: Candidates, start: FloatArray
    ) -> None:
        """`start` (WIDTH, B n) holds the packets of all vehicles before the first tick."""
        self._count = columns.count
        self._valid, self._sender = candidates.valid, candidates.sender
        delay = columns.spread([scenario.links.peer_delay_s / PERIOD_S for scenario in scenarios])[:, None]
        phase = columns.phase_steps / TELEMETRY_STEPS
        ticks_late = phase[candidates.sender] - phase[:, None] + delay
        self._lag = lag = ticks_until_use(ticks_late)
        jitter_s = max(scenario.links.peer_jitter_s for scenario in scenarios)
        is_random = jitter_s > 0.0 or any(scenario.links.peer_loss > 0.0 for scenario in scenarios)
        self._arrivals = LinkArrivals(scenarios, columns, candidates.valid, ticks_late) if is_random else None
        oldest_s = max(scenario.fleet.peers.max_age_s for scenario in scenarios) + jitter_s if is_random else 0.0
        self._kept = int(lag.max()) + ceil(oldest_s / PERIOD_S) + 3
        self._ring = np.broadcast_to(start.T, (self._kept, columns.count, WIDTH)).reshape(-1, WIDTH).copy()
        self._motions = self._ring[:, :6].copy()  # positions and velocities alone, for the range rule
        self._first_index = (-lag % self._kept) * columns.count + candidates.sender

    def send(self, tick: int, group: slice, packets: FloatArray) -> None:
        """Store the packets (WIDTH, G) of these columns."""
        begin = tick % self._kept * self._count
        self._ring[begin + group.start : begin + group.stop] = packets.T
        self._motions[begin + group.start : begin + group.stop] = packets[:6].T

    def receive(self, tick: int, group: slice) -> ReceivedPackets:
        """The newest packets of this group in this tick."""
        if self._arrivals is None:
            indices = self._first_index[group] + tick % self._kept * self._count
            return ReceivedPackets(indices, self._valid[group], None)
        newest = self._arrivals.newest(tick, group)
        ages_ticks = tick - newest - self._lag[group]
        indices = newest % self._kept * self._count + self._sender[group]
        fresh = self._arrivals.fresh(ages_ticks, group) & self._valid[group]
        return ReceivedPackets(indices, fresh, np.multiply(ages_ticks, PERIOD_S, dtype=np.float64))

    def packets(self, received: ReceivedPackets) -> FloatArray:
        """Packets (G, K, WIDTH)."""
        return self._ring.take(received.indices, axis=0, mode="wrap")

    def reduced_positions_enu_m(self, received: ReceivedPackets) -> FloatArray:
        """Positions minus slots (G, K, 3), extrapolated to this tick."""
        motions = self._motions.take(received.indices, axis=0, mode="wrap")
        if received.age_s is not None:
            motions[:, :, :3] += motions[:, :, 3:] * received.age_s[:, :, None]
        return motions[:, :, :3]
