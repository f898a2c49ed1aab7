"""The bounds of `serial`, with ideal double integrators: they depend neither on the number of vehicles nor on the graph.

The theorem of the paper was not read. These bounds follow from the equation: with z = e' + a M e and q = e' + b M e it is
z' = -b M z and q' = -a M q, and exp(-M t) enlarges no maximum.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from random import Random

import numpy as np
import pytest

from companion.analysis.interaction import FloatArray
from companion.laws import FormationState, Law, Neighbour, Own
from companion.laws.serial import Serial
from companion.laws.weighted import Weighted

Graph = Mapping[int, tuple[int, ...]]
STEP_S, LASTS = 0.05, 160
CASES = 16  # initial states at once: the law takes arrays
AS_PUBLISHED = Serial(feedforward=0.0)
A, B = AS_PUBLISHED.inner_rate_1_s, AS_PUBLISHED.outer_rate_1_s


def undirected(n: int, edges: set[tuple[int, int]]) -> Graph:
    return {i: tuple(sorted({a + b - i for a, b in edges if i in (a, b)})) for i in range(n)}


def chain(n: int) -> Graph:
    return undirected(n, {(i, i + 1) for i in range(n - 1)})


def ring(n: int) -> Graph:
    return undirected(n, {(i, (i + 1) % n) for i in range(n)})


def grid(side: int) -> Graph:
    n = side * side
    beside = {(i, i + 1) for i in range(n) if (i + 1) % side}
    return undirected(n, beside | {(i, i + side) for i in range(n - side)})


def drawn(n: int, seed: int) -> Graph:
    random = Random(seed)
    tree = {(random.randrange(i), i) for i in range(1, n)}
    return undirected(n, tree | {tuple(sorted(random.sample(range(n), 2))) for _ in range(n)})  # type: ignore[misc]


GRAPHS = {
    "chain of 4": chain(4),
    "chain of 40": chain(40),
    "ring of 20": ring(20),
    "grid of 4 x 4": grid(4),
    "random": drawn(20, 1),
}


def hops(graph: Graph) -> list[int]:
    """PrC of each vehicle; vehicle 0 leads."""
    prcs, at = {0: 1}, [0]
    for i in at:
        for j in graph[i]:
            if j not in prcs:
                prcs[j] = prcs[i] + 1
                at.append(j)
    return [prcs[i] for i in sorted(graph)]


@dataclass
class Fleet:
    """Double integrators on x; every row of the arrays is a vehicle, every column another initial state."""

    law: Law
    graph: Graph
    x: FloatArray
    v: FloatArray

    def __post_init__(self) -> None:
        self.prcs, self.u = hops(self.graph), np.zeros_like(self.x)

    def published(self, reference: FormationState) -> FloatArray:
        """A M e of every vehicle."""
        return np.array([self.law.publish(*self._known(i, reference))[0][0] for i in self.graph])

    def step(self, reference: FormationState) -> None:
        values = self.published(reference) if self.law.publishes else np.zeros_like(self.x)
        self.u = np.array([self.law.acceleration(*self._known(i, reference, values))[0] for i in self.graph])
        self.x = self.x + self.v * STEP_S + 0.5 * self.u * STEP_S**2
        self.v = self.v + self.u * STEP_S

    def _known(
        self, i: int, reference: FormationState, values: FloatArray | None = None
    ) -> tuple[Own, list[Neighbour], FormationState | None]:
        own = Own(*[(row[i], 0.0, 0.0) for row in (self.x, self.v, self.u)])
        others = [
            Neighbour(
                *[(row[j], 0.0, 0.0) for row in (self.x, self.v, self.u)],
                prc=self.prcs[j],
                values=() if values is None else ((values[j], 0.0, 0.0),),
            )
            for j in self.graph[i]
        ]
        return own, others, reference if i == 0 else None


AT_REST = FormationState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def fleet(law: Law, graph: Graph, *, stretched: bool = False) -> Fleet:
    """Errors and velocities at random, and in the first column every vehicle a metre behind its nearest neighbour."""
    random = np.random.default_rng(3)
    x, v = (random.uniform(-1.0, 1.0, (len(graph), CASES)) for _ in range(2))
    x[:, 0], v[:, 0] = [-prc for prc in hops(graph)], 0.0
    return Fleet(law, graph, x[:, :1], v[:, :1]) if stretched else Fleet(law, graph, x, v)


def most(rows: FloatArray) -> FloatArray:
    """Maximum norm of each column."""
    return np.abs(rows).max(axis=0)


@pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS)
def test_no_speed_and_no_distance_exceeds_a_bound_without_the_number_of_vehicles(graph: Graph) -> None:
    flown = fleet(AS_PUBLISHED, graph)
    me = flown.published(AT_REST) / A
    z0, q0 = most(flown.v + A * me), most(flown.v + B * me)
    speed, apart = (B * z0 + A * q0) / (B - A), (z0 + q0) / (B - A)
    for _ in range(LASTS):
        flown.step(AT_REST)
        me = flown.published(AT_REST) / A
        assert (most(flown.v) <= speed + 1e-9).all()
        assert (most(me) <= apart + 1e-9).all()
        assert (most(flown.v + A * me) <= 1.02 * z0).all()  # neither of the two laws enlarges its maximum
        assert (most(flown.v + B * me) <= 1.02 * q0).all()


def largest_apart_m(law: Law, graph: Graph, measured: Callable[[Fleet], FloatArray]) -> float:
    flown = fleet(law, graph, stretched=True)
    largest_m = 0.0
    for _ in range(3 * LASTS):
        flown.step(AT_REST)
        largest_m = max(largest_m, float(measured(flown).max()))
    return largest_m


def test_a_stretched_chain_overshoots_under_the_papers_law_and_not_under_serial() -> None:
    def ahead(flown: Fleet) -> FloatArray:
        return flown.x

    serial_m = [largest_apart_m(AS_PUBLISHED, chain(n), ahead) for n in (5, 20)]
    assert serial_m == pytest.approx([0.0, 0.0], abs=0.01)
    assert largest_apart_m(Weighted(), chain(20), ahead) > 1.0


@pytest.mark.parametrize("graph", GRAPHS.values(), ids=GRAPHS)
def test_with_the_feedforward_no_error_exceeds_the_first_ones(graph: Graph) -> None:
    """With all of the acceleration e'' + (a + b) e' + a b M e = 0: e' = a (q - e), q' = -b (q - W e) stay within the first."""
    flown = fleet(Serial(), graph)
    first = np.maximum(most(flown.x), most(flown.x + flown.v / A))
    for _ in range(LASTS):
        flown.step(AT_REST)
        assert (most(flown.x) <= 1.02 * first).all()


@pytest.mark.parametrize("feedforward", [0.0, 0.9])
def test_behind_an_accelerating_leader_the_error_is_quadratic_in_the_depth(feedforward: float) -> None:
    n, acceleration = 5, 0.5
    flown = Fleet(Serial(feedforward=feedforward, weight_ratio=0.001), chain(n), *np.zeros((2, n, 1)))
    for k in range(4 * LASTS):
        t = k * STEP_S
        reference = FormationState((0.5 * acceleration * t * t, 0.0, 0.0), (acceleration * t, 0.0, 0.0))
        flown.step(FormationState(*[reference.position_enu_m, reference.velocity_enu_m_s], (acceleration, 0.0, 0.0)))
    behind = flown.x[0, 0] - flown.x[:, 0]
    lacking = (1.0 - feedforward) * acceleration / (A * B)
    assert behind == pytest.approx([hop * (hop + 1) / 2 * lacking for hop in range(n)], rel=0.05, abs=0.01)


def test_s_of_a_neighbour_is_as_new_as_its_velocity() -> None:
    def u(velocity_m_s: float, behind_m_s: float) -> float:
        ahead = Neighbour((0.0, 0.0, 0.0), (velocity_m_s, 0.0, 0.0), values=((behind_m_s, 0.0, 0.0),))
        return AS_PUBLISHED.acceleration(Own((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)), [ahead], None)[0]

    assert u(1.0, 0.0) == pytest.approx(A + B)  # s_j = v_j: where its own neighbours are
    assert u(0.0, 0.5) == pytest.approx(B * 0.5)
    assert u(1.0, -1.0) == pytest.approx(A)  # s_j = 0


def test_a_follower_without_neighbours_gives_and_publishes_zero() -> None:
    own = Own((1.0, 2.0, 3.0), (1.0, 0.0, 0.0))
    assert Serial().acceleration(own, [], None) == (0.0, 0.0, 0.0)
    assert Serial().publish(own, [], None) == ((0.0, 0.0, 0.0),)
