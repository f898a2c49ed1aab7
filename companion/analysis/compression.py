"""How near two vehicles come while the formation follows a reference: its frequency response.

Lag, delay and drag make every vehicle follow its neighbours late, so turns and braking compress a formation. The response x_i/r
of each vehicle is that of `network.py`, with the model of MODEL.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from math import cos, dist, hypot, inf, pi, sin

from companion.analysis.network import LinearNetwork
from companion.analysis.response import MODEL, Graph
from companion.geometry.curves import Harmonic
from companion.laws import Law
from companion.types.steps import Steps, whole
from companion.types.values import Vector3

PHASES = 48  # two harmonics are added at so many phases of a lap
SLOWER, FINER, MOST_STEPS = 1.5, 6, 10  # search for the pace that would do
OVERSHOOT = 1.3  # at its start a motion shifts two vehicles by this factor more than when steady; flown: 1.2
ROUNDING = 0.02  # tolerance relative to the limit, less than sensor errors
COST_PER_STEP = 700  # see Chain.cost

Motion = Sequence[Harmonic]
"""Harmonics that are flown at the same time."""


@dataclass(frozen=True, slots=True)
class ClosestPair:
    """Two vehicles and their least distance as `separation_m` counts it; or one vehicle twice that cannot keep up."""

    one_id: int
    other_id: int
    distance_m: float


@dataclass(frozen=True, slots=True)
class Chain:
    """A formation with its law: who uses whom, who leads, and the limits of speed and acceleration of a vehicle."""

    law: Law
    graph: Graph
    leaders: frozenset[int]
    drag_1_s: float
    speed_m_s: float
    acceleration_m_s2: float
    slots_enu_m: Mapping[int, Vector3] | None = None  # for a law that reads them
    _networks: list[LinearNetwork] = field(init=False, repr=False, compare=False, default_factory=list)
    _known: dict[float, dict[int, complex]] = field(init=False, repr=False, compare=False, default_factory=dict)

    def cost(self, motion: Motion) -> int:
        """Work of `closest`, about in microseconds: of each pair and of each rate that is new.

        Laws are linearised once, mostly by the check of the vehicle file, and do not count.
        """
        n = len(self.graph)
        new = sum(harmonic.rate_rad_s not in self._known for harmonic in motion)
        return n * (n - 1) // 2 * (1 if len(motion) == 1 else PHASES // 2) + new * n**3 // 4

    def responses(self, rate_rad_s: float) -> dict[int, complex]:
        """x_i/r of each vehicle at this rate."""
        if (known := self._known.get(rate_rad_s)) is None:
            known = self._known[rate_rad_s] = self.solve(rate_rad_s)
        return known

    def solve(self, rate_rad_s: float) -> dict[int, complex]:
        """The responses from the linear equations of the formation, whose size the cost of a new rate comes from."""
        if not self._networks:
            self._networks.append(LinearNetwork(self.graph, self.leaders, self.law, self.slots_enu_m, self.drag_1_s))
        return self._networks[0].responses(1j * rate_rad_s, replace(MODEL, drag_1_s=self.drag_1_s))

    def closest(self, motion: Motion, slots_m: Mapping[int, Vector3]) -> ClosestPair:
        """The least distance of any two vehicles in this motion; 0 for a vehicle beyond its speed or acceleration.

        `slots_m` are the slots in the coordinates that count for distances.
        """
        responses = [self.responses(harmonic.rate_rad_s) for harmonic in motion]
        for i in self.graph:
            speed_m_s = acceleration_m_s2 = 0.0
            for harmonic, response in zip(motion, responses, strict=True):
                moved_m_s = abs(response[i]) * harmonic.size_m * harmonic.rate_rad_s
                speed_m_s += moved_m_s
                acceleration_m_s2 += moved_m_s * abs(1j * harmonic.rate_rad_s + self.drag_1_s)
            if speed_m_s > self.speed_m_s * (1.0 + ROUNDING) or acceleration_m_s2 > self.acceleration_m_s2:
                return ClosestPair(i, i, 0.0)
        worst = ClosestPair(0, 0, inf)
        ids = sorted(slots_m)
        for index, i in enumerate(ids):
            for j in ids[:index]:
                apart_m = dist(slots_m[i], slots_m[j])
                shifts = [OVERSHOOT * (response[i] - response[j]) for response in responses]
                most_m = sum(abs(shift) * harmonic.size_m for shift, harmonic in zip(shifts, motion, strict=True))
                if apart_m - most_m < worst.distance_m:
                    nearest_m = _nearest_m(slots_m[i], slots_m[j], motion, shifts)
                    if nearest_m < worst.distance_m:
                        worst = ClosestPair(j, i, nearest_m)
        return worst


@dataclass(frozen=True, slots=True)
class RefusedCase:
    """One motion for one chain, and the pair that comes nearest in it."""

    chain: Chain
    motion: Motion
    pair: ClosestPair


def refused_cases(
    chains: Iterable[Chain], motions: Sequence[Motion], slots_m: Mapping[int, Vector3], separation_m: float
) -> Steps[list[RefusedCase]]:
    """The cases in which two vehicles come nearer than `separation_m`."""
    done = 0
    found: list[RefusedCase] = []
    for chain in chains:
        done += len(slots_m) ** 2
        for motion in motions:
            cost = chain.cost(motion)
            if done and done + cost > COST_PER_STEP:
                done = 0
                yield
            pair = chain.closest(motion, slots_m)
            if _is_too_near(pair, separation_m):
                found.append(RefusedCase(chain, motion, pair))
            done += cost
    return found


def too_close(
    chains: Iterable[Chain], motions: Sequence[Motion], slots_m: Mapping[int, Vector3], separation_m: float
) -> ClosestPair | None:
    """The first pair that comes nearer than `separation_m` in any of the motions; None where the law keeps the distance."""
    return next((case.pair for case in whole(refused_cases(chains, motions, slots_m, separation_m))), None)


def slower_by(refused: Sequence[RefusedCase], slots_m: Mapping[int, Vector3], separation_m: float) -> Steps[float]:
    """How many times longer the same motions must take, so that the law keeps the distance; inf where no pace does.

    The search is done for the worst case. The others only have to be checked at the pace that is found, most of all once.
    """
    times = 1.0
    while refused:
        worst = min(refused, key=lambda case: case.pair.distance_m)
        times = yield from _pace_of(worst, times, slots_m, separation_m)
        if times == inf:
            return inf
        still: list[RefusedCase] = []
        for case in refused:
            pair = _slowed(case, times, slots_m)
            if case is not worst and _is_too_near(pair, separation_m):
                still.append(RefusedCase(case.chain, case.motion, pair))
            yield
        refused = still
    return times


def _pace_of(case: RefusedCase, times: float, slots_m: Mapping[int, Vector3], separation_m: float) -> Steps[float]:
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


def _slowed(case: RefusedCase, times: float, slots_m: Mapping[int, Vector3]) -> ClosestPair:
    return case.chain.closest([harmonic.slowed(times) for harmonic in case.motion], slots_m)


def _is_too_near(pair: ClosestPair, separation_m: float) -> bool:
    return pair.distance_m < separation_m * (1.0 - ROUNDING)


def _nearest_m(one_m: Vector3, other_m: Vector3, motion: Motion, shifts: Sequence[complex]) -> float:
    """Least distance of two vehicles whose slots are shifted by these responses to the harmonics."""
    x, y, z = one_m[0] - other_m[0], one_m[1] - other_m[1], one_m[2] - other_m[2]
    if any(harmonic.rotates for harmonic in motion):
        level_m = sum(
            abs(shift) * max(harmonic.amplitude_enu_m[:2]) for shift, harmonic in zip(shifts, motion, strict=True)
        )
        rise_m = sum(abs(shift) * harmonic.amplitude_enu_m[2] for shift, harmonic in zip(shifts, motion, strict=True))
        return hypot(max(0.0, hypot(x, y) - level_m), max(0.0, abs(z) - rise_m))
    if len(motion) == 1:  # to and fro on a straight line
        ax, ay, az = motion[0].amplitude_enu_m
        most = abs(shifts[0])
        way = min(max(-(x * ax + y * ay + z * az) / (ax * ax + ay * ay + az * az), -most), most)
        return hypot(x + way * ax, y + way * ay, z + way * az)
    slowest_rad_s = min(harmonic.rate_rad_s for harmonic in motion)
    nearest_m = inf
    for step in range(PHASES):
        phase = 2.0 * pi * step / PHASES
        px, py, pz = x, y, z
        for harmonic, shift in zip(motion, shifts, strict=True):
            angle = phase * harmonic.rate_rad_s / slowest_rad_s
            moved = shift.real * sin(angle) + shift.imag * cos(angle)
            ax, ay, az = harmonic.amplitude_enu_m
            px, py, pz = px + moved * ax, py + moved * ay, pz + moved * az
        nearest_m = min(nearest_m, hypot(px, py, pz))
    return nearest_m
