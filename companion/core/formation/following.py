"""How near two vehicles come while the formation follows a reference: the frequency response of the law.

Lag, delay and drag make every vehicle follow its neighbours late, so turns and braking compress a formation. Each vehicle is a
double integrator with drag behind a first-order attitude lag and a delay, as in `stability/prediction.py`. With
s = j omega, A = s^2 + c s, H = exp(-s D)/(1 + s T) and K = k1 + k2 s, eq. 14 with feed-forward gives for a follower

    (A + H K) x_i = (H K + g exp(-s m) A) sum_j w_ij x_j

and for a leader the same with the reference as one more neighbour. The solution is the response x_i/r of each vehicle.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from companion.core.consensus.law import FormationLaw
from companion.core.consensus.priority import next_prc
from companion.core.consensus.weights import neighbour_weights
from companion.geometry.vectors import minus
from companion.types.steps import Steps, whole
from companion.types.vectors import Vector3

LAG_S, DELAY_S, FEEDFORWARD_DELAY_S = 0.2, 0.05, 0.02  # of stability/prediction.py
PHASES = 48  # of a lap at which two harmonics are added
SLOWER, FINER, MOST_STEPS = 1.5, 6, 10  # search for the pace that would do
OVERSHOOT = 1.3  # of the shift of two vehicles when a motion begins, relative to that of the steady motion; flown: 1.2
ROUNDING = 0.02  # of the separation: less than sensor errors
PAIRS_PER_STEP = 1500  # of vehicles, over all motions of a step

Graph = Mapping[int, Sequence[int]]
Reals = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Indices = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Harmonic:
    """A periodic part of the reference: each axis moves by its amplitude [m] at this rate.

    `rotates`: in all horizontal directions in turn, or in one that is not known.
    """

    rate_rad_s: float
    amplitude_enu_m: Vector3
    rotates: bool = False

    def slowed(self, times: float) -> Harmonic:
        return Harmonic(self.rate_rad_s / times, self.amplitude_enu_m, self.rotates)

    @property
    def size_m(self) -> float:
        x, y, z = self.amplitude_enu_m
        return max(hypot(x, z), hypot(y, z)) if self.rotates else hypot(x, y, z)


Motion = Sequence[Harmonic]
"""Harmonics that are flown at the same time."""


@dataclass(frozen=True, slots=True)
class Pair:
    """Two vehicles and their least distance as `separation_m` counts it; or one vehicle twice that cannot keep up."""

    one_id: int
    other_id: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class Chain:
    """A formation with its law: who uses whom, who leads, and the limits of speed and acceleration of a vehicle."""

    law: FormationLaw
    graph: Graph
    leaders: frozenset[int]
    drag_1_s: float
    speed_m_s: float
    acceleration_m_s2: float
    _weights: Reals = field(init=False, repr=False, compare=False)  # w_ij: a row for each vehicle
    _leads: NDArray[np.bool_] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        column, prcs = {i: k for k, i in enumerate(self.graph)}, _prcs(self.graph, self.leaders)
        weights = np.zeros((len(column), len(column)))
        for i, neighbours in self.graph.items():
            used = neighbours if i not in self.leaders or self.law.leader_uses_neighbours else ()
            of_used = neighbour_weights([prcs[j] for j in used], self.law.exponent)
            weights[column[i], [column[j] for j in used]] = of_used
        object.__setattr__(self, "_weights", weights)
        object.__setattr__(self, "_leads", np.array([i in self.leaders for i in self.graph]))

    def responses(self, rate_rad_s: float) -> dict[int, complex]:
        """x_i/r of each vehicle at this rate."""
        (row,) = self.responses_at(np.array([rate_rad_s]))
        return {i: complex(response) for i, response in zip(self.graph, row, strict=True)}

    def responses_at(self, rates_rad_s: Reals) -> Complexes:
        """x_i/r at each of these rates: a row for each rate, a column for each vehicle in the order of the graph."""
        s = 1j * rates_rad_s
        gains, g, leads = self.law.gains, self.law.feedforward, self._leads
        plant, follow = s * s + self.drag_1_s * s, np.exp(-s * DELAY_S) / (1.0 + s * LAG_S)
        fed_back = follow * (gains.position_1_s2 + gains.velocity_1_s * s)
        from_neighbours = fed_back + g * np.exp(-s * FEEDFORWARD_DELAY_S) * plant
        from_each = np.where(leads, fed_back[:, None], from_neighbours[:, None])
        rows = -from_each[:, :, None] * self._weights
        n = len(leads)
        used = leads.astype(float) + self._weights.any(axis=1)
        rows[:, range(n), range(n)] += plant[:, None] + fed_back[:, None] * used
        right = np.where(leads, (fed_back + g * follow * s * s)[:, None], 0.0)
        return np.asarray(np.linalg.solve(rows, right[..., None])[..., 0])

    def closest(self, motion: Motion, slots_m: Mapping[int, Vector3]) -> Pair:
        """The least distance of any two vehicles in this motion; 0 for a vehicle beyond its speed or acceleration.

        `slots_m` are the slots in the coordinates that count for distances.
        """
        return self.closest_of([motion], slots_m)[0]

    def closest_of(self, motions: Sequence[Motion], slots_m: Mapping[int, Vector3]) -> list[Pair]:
        """`closest` for each of these motions."""
        harmonics = [harmonic for motion in motions for harmonic in motion]
        first = np.cumsum([0, *(len(motion) for motion in motions[:-1])])  # harmonic of each motion
        rates = np.array([harmonic.rate_rad_s for harmonic in harmonics])
        sizes = np.array([harmonic.size_m for harmonic in harmonics])
        responses = self.responses_at(rates)
        moved = np.abs(responses) * (sizes * rates)[:, None]
        speeds = np.add.reduceat(moved, first)
        accelerations = np.add.reduceat(moved * np.abs(1j * rates + self.drag_1_s)[:, None], first)
        too_fast = (speeds > self.speed_m_s * (1.0 + ROUNDING)) | (accelerations > self.acceleration_m_s2)
        ids = list(self.graph)
        column = {i: k for k, i in enumerate(ids)}
        pairs = [(j, i) for index, i in enumerate(sorted(slots_m)) for j in sorted(slots_m)[:index]]
        one, other = [column[j] for j, _ in pairs], [column[i] for _, i in pairs]
        apart = np.array([minus(slots_m[i], slots_m[j]) for j, i in pairs])
        shifts = OVERSHOOT * (responses[:, other] - responses[:, one])
        distances = _nearest_m(apart, motions, first, shifts)
        found = []
        for fast, row in zip(too_fast, distances, strict=True):
            if fast.any():
                slow = ids[int(np.argmax(fast))]
                found.append(Pair(slow, slow, 0.0))
            else:
                (j, i), nearest_m = pairs[int(np.argmin(row))], float(row.min())
                found.append(Pair(j, i, nearest_m))
        return found


@dataclass(frozen=True, slots=True)
class Case:
    """One motion for one chain, and the pair that comes nearest in it."""

    chain: Chain
    motion: Motion
    pair: Pair


def refused_cases(
    chains: Iterable[Chain], motions: Sequence[Motion], slots_m: Mapping[int, Vector3], separation_m: float
) -> Steps[list[Case]]:
    """The cases in which two vehicles come nearer than `separation_m`."""
    pairs, done = len(slots_m) * (len(slots_m) - 1) // 2, 0
    curved = any(len(motion) > 1 for motion in motions)
    cost = pairs * (PHASES // 6 if curved else 1)
    at_once = max(1, PAIRS_PER_STEP // cost)
    found: list[Case] = []
    for chain in chains:
        done += 2 * pairs
        for k in range(0, len(motions), at_once):
            some = motions[k : k + at_once]
            if done and done + cost * len(some) > PAIRS_PER_STEP:
                done = 0
                yield
            nearest = zip(some, chain.closest_of(some, slots_m), strict=True)
            found += [Case(chain, motion, pair) for motion, pair in nearest if _is_too_near(pair, separation_m)]
            done += cost * len(some)
    return found


def too_close(
    chains: Iterable[Chain], motions: Sequence[Motion], slots_m: Mapping[int, Vector3], separation_m: float
) -> Pair | None:
    """The first pair that comes nearer than `separation_m` in any of the motions; None where the law keeps the distance."""
    return next((case.pair for case in whole(refused_cases(chains, motions, slots_m, separation_m))), None)


def slower_by(refused: Sequence[Case], slots_m: Mapping[int, Vector3], separation_m: float) -> Steps[float]:
    """How many times longer the same motions must take, so that the law keeps the distance; inf where no pace does.

    The search is done for the worst case. The others only have to be checked at the pace that is found, most of all once.
    """
    times = 1.0
    while refused:
        worst = min(refused, key=lambda case: case.pair.distance_m)
        times = yield from _pace_of(worst, times, slots_m, separation_m)
        if times == inf:
            return inf
        still: list[Case] = []
        for case in refused:
            pair = _slowed(case, times, slots_m)
            if case is not worst and _is_too_near(pair, separation_m):
                still.append(Case(case.chain, case.motion, pair))
            yield
        refused = still
    return times


def _pace_of(case: Case, times: float, slots_m: Mapping[int, Vector3], separation_m: float) -> Steps[float]:
    """`slower_by` of one case that is refused at the pace `times`."""
    for _ in range(MOST_STEPS):
        too_fast, times = times, times * SLOWER
        refused = _is_too_near(_slowed(case, times, slots_m), separation_m)
        yield
        if not refused:
            break
    else:
        return inf
    for _ in range(FINER):
        between = (too_fast + times) / 2.0
        refused = _is_too_near(_slowed(case, between, slots_m), separation_m)
        too_fast, times = (between, times) if refused else (too_fast, between)
        yield
    return times


def _slowed(case: Case, times: float, slots_m: Mapping[int, Vector3]) -> Pair:
    return case.chain.closest([harmonic.slowed(times) for harmonic in case.motion], slots_m)


def _is_too_near(pair: Pair, separation_m: float) -> bool:
    return pair.distance_m < separation_m * (1.0 - ROUNDING)


def _nearest_m(apart_m: Reals, motions: Sequence[Motion], first: Indices, shifts: Complexes) -> Reals:
    """Least distance of each pair in each motion: a row for each motion.

    `apart_m` is between the slots of a pair. `shifts` are its responses to each harmonic, those of a motion from `first` on.
    """
    if all(any(harmonic.rotates for harmonic in motion) for motion in motions):
        return _nearest_in_any_direction_m(apart_m, motions, first, shifts)
    if all(len(motion) == 1 for motion in motions):
        return _nearest_on_lines_m(apart_m, np.array([motion[0].amplitude_enu_m for motion in motions]), shifts)
    each = zip(motions, first.tolist(), strict=True)
    return np.array([_nearest_on_curve_m(apart_m, motion, shifts[at : at + len(motion)]) for motion, at in each])


def _nearest_in_any_direction_m(apart_m: Reals, motions: Sequence[Motion], first: Indices, shifts: Complexes) -> Reals:
    amplitudes = np.array([harmonic.amplitude_enu_m for motion in motions for harmonic in motion])
    sizes = np.abs(shifts)
    level = np.add.reduceat(sizes * amplitudes[:, :2].max(axis=1)[:, None], first)
    rise = np.add.reduceat(sizes * amplitudes[:, 2:], first)
    beside = np.maximum(0.0, np.hypot(apart_m[:, 0], apart_m[:, 1]) - level)
    return np.asarray(np.hypot(beside, np.maximum(0.0, np.abs(apart_m[:, 2]) - rise)))


def _nearest_on_lines_m(apart_m: Reals, amplitudes: Reals, shifts: Complexes) -> Reals:
    """One harmonic moves a pair to and fro on a straight line."""
    squared, sizes = (amplitudes**2).sum(axis=1)[:, None], np.abs(shifts)
    way = np.clip(-(amplitudes @ apart_m.T) / squared, -sizes, sizes)
    return np.asarray(np.linalg.norm(apart_m + way[:, :, None] * amplitudes[:, None, :], axis=2))


def _nearest_on_curve_m(apart_m: Reals, motion: Motion, shifts: Complexes) -> Reals:
    amplitudes = np.array([harmonic.amplitude_enu_m for harmonic in motion])
    rates = np.array([harmonic.rate_rad_s for harmonic in motion])
    angles = 2.0 * np.pi * np.arange(PHASES)[:, None] / PHASES * rates / rates.min()
    moved = np.sin(angles)[:, :, None] * shifts.real + np.cos(angles)[:, :, None] * shifts.imag
    ways = np.einsum("shp,ha->spa", moved, amplitudes)
    return np.asarray(np.linalg.norm(apart_m + ways, axis=2).min(axis=0))


def _prcs(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """PrC of each vehicle, once it has settled (Algorithm 1)."""
    n = len(graph)
    prcs = {i: 1 if i in leaders else n for i in graph}
    for _ in graph:
        after = {i: next_prc(i in leaders, [prcs[j] for j in neighbours], n) for i, neighbours in graph.items()}
        if after == prcs:
            break
        prcs = after
    return prcs
