"""The delay margin against an independent computation: roots, with Pade filters of order 6."""

from math import factorial

import numpy as np
import pytest

from companion.analysis.interaction import Coupling, couple
from companion.analysis.margins import delay_margin_with_lag_s
from companion.analysis.response import LinearModel
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.formation import Gains
from tests.helpers.closed_forms import fed_forward
from tests.helpers.laws import average_26, law_of

ORDER = 6
MODEL = LinearModel()
PAPER = Gains(1.39, 1.2)


def chain(n: int) -> dict[int, list[int]]:
    return {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}


RING = {1: [2, 5], 2: [1, 3], 3: [2, 4], 4: [3, 5], 5: [4, 1]}
STAR = {1: [2, 3, 4], 2: [1], 3: [1], 4: [1]}


def delay_filter(delay_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A, b, c of e^{-sd} = 1 + c (s - A)^-1 b, by Pade; the order is even."""
    m = ORDER
    share = [
        factorial(2 * m - k) * factorial(m) / (factorial(2 * m) * factorial(k) * factorial(m - k)) for k in range(m)
    ]
    top = factorial(m) / factorial(2 * m)
    matrix = np.eye(m, k=1)
    matrix[-1] = -np.array(share) / top
    out = np.array([((-1) ** k - 1) * value / top for k, value in enumerate(share)])
    return matrix / delay_s, np.eye(m)[-1] / delay_s, out


def abscissa(coupling: Coupling, delay_s: float) -> float:
    """Largest real part of the spectrum of x = [e, e', e'', command filters, feed-forward filters]."""
    n, law = len(coupling.G), coupling.law
    one, none = np.eye(n), np.zeros((n, n))
    matrix, into, out = delay_filter(delay_s)
    heard_matrix, heard_into, heard_out = delay_filter(MODEL.feedforward_delay_s)
    forward = fed_forward(*coupling.network.formation, law)
    wide = np.zeros((n, ORDER * n))
    back = [law.position_gain_1_s2 * coupling.G, law.velocity_gain_1_s * coupling.G]
    u = np.linalg.solve(one - forward, np.hstack([-back[0], -back[1], none, wide, forward @ np.kron(one, heard_out)]))
    position, velocity = (np.hstack([*part, wide, wide]) for part in ([none, one, none], [none, none, one]))
    arrived = u + np.hstack([none, none, none, np.kron(one, out), wide])
    acceleration = (arrived - np.hstack([none, none, one, wide, wide])) / MODEL.attitude_lag_s
    tall = np.zeros((ORDER * n, 3 * n))
    square = np.zeros((ORDER * n, ORDER * n))
    first = np.hstack([tall, np.kron(one, matrix), square]) + np.kron(one, into[:, np.newaxis]) @ u
    second = np.hstack([tall, square, np.kron(one, heard_matrix)]) + np.kron(one, heard_into[:, np.newaxis]) @ u
    return float(np.linalg.eigvals(np.vstack([position, velocity, acceleration, first, second])).real.max())


def first_unstable_s(coupling: Coupling) -> float:
    low, high = 0.0, 2e-3
    while abscissa(coupling, high) < 0.0:
        low, high = high, 1.1 * high
    for _ in range(40):
        middle = (low + high) / 2.0
        low, high = (middle, high) if abscissa(coupling, middle) < 0.0 else (low, middle)
    return low


LAWS = [
    law_of(Gains(2.0, 2.4), 8.0, True, 0.9),
    law_of(Gains(1.0, 2.0), 1.0, False, 0.5),
    law_of(Gains(1.39, 0.8), 2.0, True, 0.7),
    law_of(Gains(6.0, 5.0), 0.0, True, 0.3),
    law_of(PAPER, 1.0, True),
    law_of(Gains(1.39, 0.36), 1.0, True),
    law_of(Gains(1.39, 0.29), 1.0, True),
    law_of(Gains(0.1, 3.0), 8.0, True),
    law_of(Gains(8.0, 9.0), 0.0, True),
    average_26(Gains(2.0, 0.9)),
]


@pytest.mark.parametrize(
    "graph", [chain(1), chain(2), chain(5), RING, STAR], ids=["one", "two", "five", "ring", "star"]
)
@pytest.mark.parametrize("law", LAWS)
def test_margin_is_within_a_thousandth_and_never_too_large(graph: dict[int, list[int]], law: NeighbourFeedback) -> None:
    coupling = couple(graph, {1}, law)
    independent_s, margin_s = first_unstable_s(coupling), delay_margin_with_lag_s(coupling, MODEL)
    assert 0.999 * independent_s <= margin_s <= (1.0 + 1e-5) * independent_s  # a triple root is found to 2e-6
