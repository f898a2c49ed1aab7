"""The linear model, and how near two vehicles come while the formation follows a reference: its frequency response.

Lag, delay and drag make every vehicle follow its neighbours late, so turns and braking compress a formation. Each vehicle is a
double integrator with drag behind a first-order attitude lag and a delay, `LinearModel`. With
s = j omega, A = s^2 + c s, H = exp(-s D)/(1 + s T) and K = k1 + k2 s, eq. 14 with feed-forward gives for a follower

    (A + H K) x_i = (H K + g exp(-s m) A) sum_j w_ij x_j

and for a leader the same with the reference as one more neighbour, of which it adds g H A r. The solution is the response
x_i/r of each vehicle.
"""

from __future__ import annotations

from cmath import exp
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import cos, dist, hypot, inf, pi, sin
from typing import Any

from companion.core.filter.motion import LAG_S
from companion.geometry.curves import Harmonic
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.autopilot import AutopilotKind
from companion.types.steps import Steps, whole
from companion.types.values import Vector3

TICK_S = 0.02
PHASES = 48  # two harmonics are added at so many phases of a lap
SLOWER, FINER, MOST_STEPS = 1.5, 6, 10  # search for the pace that would do
OVERSHOOT = 1.3  # at its start a motion shifts two vehicles by this factor more than when steady; flown: 1.2
ROUNDING = 0.02  # tolerance relative to the limit, less than sensor errors
COST_PER_STEP = 700  # see Chain.cost

Graph = Mapping[int, Collection[int]]
"""Vehicle id -> ids of its neighbours."""


@dataclass(frozen=True, slots=True)
class LinearModel:
    """Lags and delays of the loop; the defaults are on the late side of PX4 and a local network, with a lag of first order.

    A commanded acceleration is flown by the share 1/(1 + T s + a s^2 + b s^3), with T of `attitude_lag_s`, and after `delay_s`:
    the delay of the whole loop, including the half tick of the zero-order hold. `neighbour_delay_s` is the age of a neighbour's
    position and velocity at their use, and `feedforward_delay_s` that of its acceleration command.
    """

    attitude_lag_s: float = LAG_S
    delay_s: float = 0.05
    feedforward_delay_s: float = TICK_S
    neighbour_delay_s: float = 0.0
    attitude_a_s2: float = 0.0
    attitude_b_s3: float = 0.0
    drag_1_s: float = 0.0

    def flown_share(self, s: Any) -> Any:
        """The flown acceleration over the commanded one, without the delay. `s` is complex, or an array."""
        return 1.0 / (1.0 + s * (self.attitude_lag_s + s * (self.attitude_a_s2 + s * self.attitude_b_s3)))


@dataclass(frozen=True, slots=True)
class AttitudeLoop:
    """An autopilot's attitude control as measured, with motors of usual lag: gains on tilt and on rates, and the delay.

    It takes a stream of setpoints `engages_s` after the command to form.
    """

    tilt_gain_1_s: float
    rate_gain_1_s: float
    delay_s: float
    engages_s: float
    motor_lag_s: float = 0.05


# As measured for the stand-ins, which have the same figures. Where one of the two is stable with a law, PX4 is the later one.
ATTITUDE_LOOPS = {
    AutopilotKind.PX4: AttitudeLoop(6.5, 12.5, 0.028, 0.3),
    AutopilotKind.ARDUPILOT: AttitudeLoop(5.5, 28.0, 0.004, 0.0),
}
USUAL_DRAG_1_S = 0.25  # drag of a small open quadrotor
AUTOPILOT_STEP_S = 0.002
ON_BOARD_S = 0.001 + AUTOPILOT_STEP_S  # telemetry and setpoint on their way as well
USUAL_LINK_S = 0.001  # between agents on a local network
LATE_LINK_S = 0.1  # the latest link between agents that laws are made for
SPARE_S = (
    0.5 * TICK_S
)  # of the delay: packets and setpoints may wait for a whole tick, where half of one is the average


def links_borne_s(link_s: float) -> Sequence[float]:
    """The links that a law must be stable with: that of the scenario; of the usual one, which names no network, any."""
    return (LATE_LINK_S, USUAL_LINK_S, 0.5 * LATE_LINK_S) if link_s <= USUAL_LINK_S else (link_s,)


def flown_model(
    autopilot: AutopilotKind = AutopilotKind.PX4,
    link_s: float = USUAL_LINK_S,
    drag_1_s: float = USUAL_DRAG_1_S,
    on_board_s: float = ON_BOARD_S,
) -> LinearModel:
    """The model of a vehicle as it flies, behind links that take `link_s`. A packet waits half a tick on average, too."""
    loop = ATTITUDE_LOOPS[autopilot]
    both_1_s2, age_s = loop.tilt_gain_1_s * loop.rate_gain_1_s, link_s + 0.5 * TICK_S
    return LinearModel(
        attitude_lag_s=1.0 / loop.tilt_gain_1_s,
        delay_s=loop.delay_s + on_board_s + 0.5 * TICK_S,
        feedforward_delay_s=age_s,
        neighbour_delay_s=age_s,
        attitude_a_s2=1.0 / both_1_s2,
        attitude_b_s3=loop.motor_lag_s / both_1_s2,
        drag_1_s=drag_1_s,
    )


MODEL = LinearModel()


def settled_prcs(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """PrC p_i at convergence of Algorithm 1: hops to the nearest leader + 1, or n without a path."""
    return dict.fromkeys(graph, len(graph)) | {i: distance + 1 for i, distance in hops(graph, leaders).items()}


def reached_from(graph: Graph, leaders: Collection[int]) -> set[int]:
    """Vehicles with a path to a leader. Lemma 1 requires that all vehicles have one."""
    return set(hops(graph, leaders))


def flown_graphs(at_start: Graph, in_slots: Graph, leaders: Collection[int]) -> Sequence[Graph]:
    """Those that a law must be stable with: at the start, and in the slots if they differ and are all in range there."""
    if in_slots == at_start or len(reached_from(in_slots, leaders)) < len(in_slots):
        return (at_start,)
    return (at_start, in_slots)


def hops(graph: Graph, leaders: Collection[int]) -> dict[int, int]:
    """Hops to the nearest leader, for each vehicle with a path to one."""
    found = dict.fromkeys(leaders, 0)
    waiting = deque(leaders)
    while waiting:
        i = waiting.popleft()
        for j in graph[i]:
            if j not in found:
                found[j] = found[i] + 1
                waiting.append(j)
    return found


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

    law: NeighbourFeedback
    graph: Graph
    leaders: frozenset[int]
    drag_1_s: float
    speed_m_s: float
    acceleration_m_s2: float
    _weights: dict[int, tuple[Sequence[int], Sequence[float]]] = field(init=False, repr=False, compare=False)
    _known: dict[float, dict[int, complex]] = field(init=False, repr=False, compare=False)  # responses by rate

    def __post_init__(self) -> None:
        prcs = settled_prcs(self.graph, self.leaders)
        weights = {}
        for i, neighbours in self.graph.items():
            shares = self.law.weights(i in self.leaders, [prcs[j] for j in neighbours])
            weights[i] = (neighbours if shares else (), shares)
        object.__setattr__(self, "_weights", weights)
        object.__setattr__(self, "_known", {})

    def cost(self, motion: Motion) -> int:
        """Work of `closest`, about in microseconds: of each pair, and of each rate that is new."""
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
        s = 1j * rate_rad_s
        gains, g = self.law.gains, self.law.feedforward
        plant, follow = s * s + self.drag_1_s * s, exp(-s * MODEL.delay_s) / (1.0 + s * MODEL.attitude_lag_s)
        fed_back = follow * (gains.position_1_s2 + gains.velocity_1_s * s)
        from_neighbours = fed_back + g * exp(-s * MODEL.feedforward_delay_s) * plant
        rows: dict[int, dict[int, complex]] = {}
        right: dict[int, complex] = {}
        for i, neighbours in self.graph.items():
            leads, (used, weights) = i in self.leaders, self._weights[i]
            from_each = fed_back if leads else from_neighbours
            row = dict.fromkeys(neighbours, 0j)
            row |= {j: -from_each * weight for j, weight in zip(used, weights, strict=True)}
            row[i] = plant + fed_back * ((1.0 if leads else 0.0) + (1.0 if used else 0.0))
            rows[i], right[i] = row, (fed_back + g * follow * plant) if leads else 0j
        return _solved(rows, right)

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


def _solved(rows: dict[int, dict[int, complex]], right: dict[int, complex]) -> dict[int, complex]:
    """Solution of a sparse system with a symmetric pattern, by elimination of the row with the fewest entries first."""
    left, order = set(rows), []
    while left:
        pivot = min(left, key=lambda i: len(rows[i]))
        left.discard(pivot)
        order.append(pivot)
        row = rows[pivot]
        diagonal = row[pivot]
        for i in row.keys() & left:
            other = rows[i]
            factor = other.pop(pivot) / diagonal
            for j, value in row.items():
                if j != pivot:
                    other[j] = other.get(j, 0j) - factor * value
            right[i] -= factor * right[pivot]
    solution: dict[int, complex] = {}
    for pivot in reversed(order):
        row = rows[pivot]
        rest = sum((value * solution[j] for j, value in row.items() if j != pivot), 0j)
        solution[pivot] = (right[pivot] - rest) / row[pivot]
    return solution
