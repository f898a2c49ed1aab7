"""Peer packets sent and received by all vehicles: companion.core.consensus.peers and `sitl.links.network` in arrays.

Times are exact, as in lockstep: a packet is used from its receiver's first tick after its arrival. It is extrapolated from its
receipt without jitter: in that tick, or in its first part, PREPARED_S before; in lockstep the agents measure that delay while
they hover. On a link counts the newest packet, with random loss and delay. Plausibility checks of peers are left out: a peer
faster than `max_speed_m_s` is used too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil

import numpy as np

from companion.analysis.interaction import FloatArray
from companion.config.fleet import EdgeNeighbours, FleetConfig
from companion.core.consensus.peers import EXTRAPOLATED_MOST_S, EXTRAPOLATED_NEAR_LEADER_S, NEAR_LEADER_PRC
from companion.link.tick import PREPARED_S
from sitl.autopilots.autopilot import DT_S
from sitl.batch.columns import LINKS, BoolArray, Columns, IntArray
from sitl.flight.files import ids_of
from sitl.flight.lockstep import TELEMETRY_STEPS
from sitl.flight.scenario import Scenario

# Numbers of a packet: position minus slot [m], velocity [m/s], acceleration command [m/s^2], or the RFT of a vehicle that is
# kept off its slot; PrC, slot, age on receipt [s], and what the law publishes.
REDUCED_POSITION, VELOCITY, ACCELERATION, STATE = slice(0, 3), slice(3, 6), slice(6, 9), slice(0, 9)
PRC, SLOT, AGE, VALUES = 9, slice(10, 13), 13, 14


@dataclass(frozen=True, slots=True)
class ReceivedPackets:
    """The newest packets of a group from its candidates, as indices (G, K) into the ring; `fresh` (G, K) marks those in use.

    `age_s` (G, K) is the time since the receipt of a packet without jitter.
    """

    indices: IntArray
    fresh: BoolArray
    age_s: FloatArray

    def only(self, members: BoolArray) -> ReceivedPackets:
        """The packets of `members` (G, K) alone, in as short rows as possible: a tenth of the candidates are in range."""
        receiver, candidate = np.nonzero(members)
        counts = members.sum(axis=1)
        first = np.cumsum(counts) - counts
        shape = (len(counts), max(1, int(counts.max())))
        at = (receiver, np.arange(receiver.size) - first[receiver])
        indices, fresh = np.zeros(shape, dtype=np.int64), np.zeros(shape, dtype=np.bool_)
        indices[at], fresh[at] = self.indices[receiver, candidate], True
        age_s = np.zeros(shape)
        age_s[at] = self.age_s[receiver, candidate]
        return ReceivedPackets(indices, fresh, age_s)


class Reception:
    """Which packet is the newest that each vehicle has received from each candidate, as a place in a ring of `kept` ticks.

    Ticks count from 0; before that every vehicle sent its start.
    """

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, candidates: Candidates, subject: int = LINKS
    ) -> None:
        """`subject` is of the random numbers."""
        self._count = columns.count
        self._valid, self._sender = candidates.valid, candidates.sender
        delay = columns.spread([scenario.links.peer_delay_s / PERIOD_S for scenario in scenarios])[:, None]
        phase = columns.phase_steps / TELEMETRY_STEPS
        ticks_late = phase[candidates.sender] - phase[:, None] + delay
        self.lag = lag = ticks_until_use(ticks_late)
        waits = lag - ticks_late > PREPARED_S / PERIOD_S + ROUND_TICKS
        self._since_receipt_s = np.where(waits, PREPARED_S, 0.0)
        jitter_s = max(scenario.links.peer_jitter_s for scenario in scenarios)
        is_random = jitter_s > 0.0 or any(scenario.links.peer_loss > 0.0 for scenario in scenarios)
        self._arrivals = LinkArrivals(scenarios, columns, candidates.valid, ticks_late, subject) if is_random else None
        oldest_s = max(scenario.fleet.peers.max_age_s for scenario in scenarios) + jitter_s if is_random else 0.0
        self.kept = int(lag.max()) + ceil(oldest_s / PERIOD_S) + 3
        self._first_index = (-lag % self.kept) * columns.count + candidates.sender

    def places(self, tick: int, group: slice) -> slice:
        """Where the packets of these columns belong in the ring."""
        begin = tick % self.kept * self._count
        return slice(begin + group.start, begin + group.stop)

    def receive(self, tick: int, group: slice) -> ReceivedPackets:
        """The newest packets of this group in this tick."""
        if self._arrivals is None:
            indices = self._first_index[group] + tick % self.kept * self._count
            return ReceivedPackets(indices, self._valid[group], self._since_receipt_s[group])
        newest = self._arrivals.newest(tick, group)
        ages_ticks = tick - newest - self.lag[group]
        indices = newest % self.kept * self._count + self._sender[group]
        fresh = self._arrivals.fresh(ages_ticks, group) & self._valid[group]
        age_s = np.multiply(ages_ticks, PERIOD_S, dtype=np.float64) + self._since_receipt_s[group]
        return ReceivedPackets(indices, fresh, age_s)


class Packets:
    """A ring of all packets that may still be used."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, candidates: Candidates, start: FloatArray
    ) -> None:
        """`start` (rows, B n) holds the packets of all vehicles before the first tick."""
        self._reception = reception = Reception(scenarios, columns, candidates)
        self.receive = reception.receive
        self.start(start)

    def start(self, packets: FloatArray) -> None:
        """Only these (rows, B n) were ever sent."""
        self._ring = np.tile(packets.T, (self._reception.kept, 1))
        self._motions = self._ring[:, :6].copy()  # positions and velocities alone, for the range rule
        self._prcs = self._ring[:, PRC].copy()

    def send(self, tick: int, group: slice, packets: FloatArray, motions: FloatArray) -> None:
        """Store the packets (rows, G) of these columns, and the positions and velocities (6, G) for the range rule."""
        places = self._reception.places(tick, group)
        self._ring[places], self._motions[places], self._prcs[places] = packets.T, motions.T, packets[PRC]

    def prcs(self, indices: IntArray) -> FloatArray:
        """PrCs of the packets at these places of the ring."""
        return self._prcs.take(indices, mode="wrap")

    def extrapolated(self, indices: IntArray, age_s: FloatArray) -> FloatArray:
        """Packets (rows, P) at these places, of this age, as `neighbour_at` of companion.core.consensus.peers sees them."""
        packets = self._ring.take(indices, axis=0, mode="wrap").T.copy()
        near_leader = packets[PRC] <= NEAR_LEADER_PRC
        used_s = np.minimum(age_s, np.where(near_leader, EXTRAPOLATED_NEAR_LEADER_S, EXTRAPOLATED_MOST_S))
        velocity, acceleration = packets[VELOCITY], packets[ACCELERATION]
        packets[REDUCED_POSITION] += used_s * (velocity + 0.5 * used_s * acceleration)
        velocity += used_s * acceleration
        packets[AGE] = age_s
        return packets

    def reduced_positions_enu_m(self, received: ReceivedPackets) -> FloatArray:
        """Positions minus slots (G, K, 3), extrapolated to this tick."""
        motions = self._motions.take(received.indices, axis=0, mode="wrap")
        motions[:, :, :3] += motions[:, :, 3:] * received.age_s[:, :, None]
        return motions[:, :, :3]


PERIOD_S = DT_S * TELEMETRY_STEPS
ROUND_TICKS = 1e-6  # tolerance within which a delay counts as whole steps


class LinkArrivals:
    """Arrival times on all links (B n, K), receiver by candidate. Ticks count from 0; earlier packets arrived in time."""

    def __init__(
        self, scenarios: Sequence[Scenario], columns: Columns, valid: BoolArray, ticks_late: FloatArray, subject: int
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
            np.random.default_rng([s.stand_in.seed, subject]) if random else None
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


@dataclass(frozen=True, slots=True)
class Candidates:
    """`sender` (B n, K) holds columns, `valid` (B n, K) whether that entry of a receiver's row is used.

    `join_m` and `leave_m` (B n,) are the distances of the range rule, infinite for neighbours by edges.
    """

    sender: IntArray
    valid: BoolArray
    join_m: FloatArray
    leave_m: FloatArray

    @property
    def by_range(self) -> bool:
        """Whether any formation has neighbours by range."""
        return bool(np.isfinite(self.join_m).any())


def candidates_of(scenarios: Sequence[Scenario], columns: Columns) -> Candidates:
    n = columns.vehicles
    others = [_others(scenario.fleet, ids_of(scenario)) for scenario in scenarios]
    most = max(1, max(len(row) for rows in others for row in rows))
    sender = np.zeros((columns.formations, n, most), dtype=np.int64)
    valid = np.zeros((columns.formations, n, most), dtype=np.bool_)
    for b, rows in enumerate(others):
        for i, row in enumerate(rows):
            sender[b, i, : len(row)] = b * n + np.array(row, dtype=np.int64)
            valid[b, i, : len(row)] = True
    ranges = np.array([_range_m(scenario.fleet) for scenario in scenarios])[columns.formation]
    return Candidates(
        sender=columns.column_of[sender.reshape(-1, most)[columns.order]],
        valid=valid.reshape(-1, most)[columns.order],
        join_m=ranges[:, 0],
        leave_m=ranges[:, 1],
    )


def everyone_of(columns: Columns) -> Candidates:
    """All others of each formation, neighbours or not."""
    n = columns.vehicles
    others = np.array([[j for j in range(n) if j != i] or [i] for i in range(n)], dtype=np.int64)
    first = np.arange(columns.formations, dtype=np.int64) * n
    sender = (first[:, None, None] + others).reshape(columns.count, -1)
    anywhere = np.full(columns.count, np.inf)
    return Candidates(
        sender=columns.column_of[sender[columns.order]],
        valid=np.full(sender.shape, n > 1),
        join_m=anywhere,
        leave_m=anywhere,
    )


def _others(fleet: FleetConfig, ids: list[int]) -> list[list[int]]:
    """For each vehicle the indices in `ids` of its possible neighbours, rising."""
    index = {vehicle_id: i for i, vehicle_id in enumerate(ids)}
    if not isinstance(fleet.neighbours, EdgeNeighbours):
        return [[j for j in range(len(ids)) if j != i] for i in range(len(ids))]
    rows: list[set[int]] = [set() for _ in ids]
    for a, b in fleet.neighbours.edges:
        rows[index[a]].add(index[b])
        rows[index[b]].add(index[a])
    return [sorted(row) for row in rows]


def _range_m(fleet: FleetConfig) -> tuple[float, float]:
    if isinstance(fleet.neighbours, EdgeNeighbours):
        return (float("inf"), float("inf"))
    return (fleet.neighbours.range_m, fleet.neighbours.range_m + fleet.neighbours.hysteresis_m)
