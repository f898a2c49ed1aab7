"""Responses of the law to a reference: against the steady state and against the model of the analysis."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from companion.analysis.compression import OVERSHOOT, Chain, Harmonic, refused_cases, slower_by, too_close
from companion.analysis.interaction import couple
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.steps import whole
from companion.types.values import Vector3
from tests.helpers.laws import average_22, average_26, cooperative, weighted

LAWS = [weighted(), average_22(), average_26(), cooperative()]
NAMES = ["weighted", "average_22", "average_26", "cooperative"]


def chain(law: NeighbourFeedback, n: int = 4, drag_1_s: float = 0.0, speed_m_s: float = 12.0) -> Chain:
    graph = {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}
    return Chain(law, graph, frozenset({1}), drag_1_s, speed_m_s, 4.5)


def slots(n: int, spacing_m: float) -> dict[int, Vector3]:
    return {i: (-spacing_m * (i - 1), 0.0, 0.0) for i in range(1, n + 1)}


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
def test_a_slow_reference_is_followed(law: NeighbourFeedback) -> None:
    for response in chain(law).responses(1e-3).values():
        assert abs(response - 1.0) < 1e-3


@pytest.mark.parametrize("law", [weighted(), average_22(), average_26()], ids=NAMES[:3])
def test_errors_at_a_constant_acceleration_are_those_of_the_interaction_matrix(law: NeighbourFeedback) -> None:
    """G k1 e = -r'' in the steady state, without drag and feed-forward."""
    formation, rate_rad_s = chain(law), 1e-3
    responses = formation.responses(rate_rad_s)
    errors = np.array([(responses[i] - 1.0) / rate_rad_s**2 for i in sorted(responses)])
    coupling = couple({i: list(j) for i, j in formation.graph.items()}, [1], law)
    steady = np.linalg.solve(coupling.G * law.position_gain_1_s2, np.ones(len(errors)))
    assert errors.real == pytest.approx(steady, rel=0.02)


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
@pytest.mark.parametrize("rate_rad_s", [0.2, 1.0])
def test_the_responses_solve_the_equations_of_the_law(law: NeighbourFeedback, rate_rad_s: float) -> None:
    """A dense solution of the same formation with a cycle, by numpy."""
    ring = {1: [2, 6], 2: [1, 3], 3: [2, 4], 4: [3, 5], 5: [4, 6], 6: [5, 1]}
    formation = Chain(law, ring, frozenset({1}), 0.25, 12.0, 4.5)
    responses = formation.responses(rate_rad_s)
    prcs = {1: 1, 2: 2, 6: 2, 3: 3, 5: 3, 4: 4}
    s = 1j * rate_rad_s
    lag = np.exp(-0.05 * s) / (1.0 + 0.2 * s)
    back = lag * (law.position_gain_1_s2 + law.velocity_gain_1_s * s)
    plant = s * s + 0.25 * s
    for i, neighbours in ring.items():
        shares = np.array(law.weights(i == 1, [prcs[j] for j in neighbours]))
        mean = sum(share * responses[j] for share, j in zip(shares, neighbours, strict=False))  # none: uses none
        if i == 1:
            used = law.leader_uses_neighbours
            left = plant * responses[1] + back * ((responses[1] - 1.0) + (responses[1] - mean if used else 0.0))
            assert left == pytest.approx(law.feedforward * lag * plant, abs=1e-9)
        else:
            forward = law.feedforward * np.exp(-0.02 * s) * plant * mean
            assert plant * responses[i] + back * (responses[i] - mean) == pytest.approx(forward, abs=1e-9)


def test_a_column_is_compressed_by_the_shift_along_it() -> None:
    formation, motion = chain(weighted(), 2), [Harmonic(0.3, (8.0, 0.0, 0.0))]
    responses = formation.responses(0.3)
    shift_m = OVERSHOOT * 8.0 * abs(responses[1] - responses[2])
    assert formation.closest(motion, slots(2, 5.0)).distance_m == pytest.approx(5.0 - shift_m, rel=0.01)
    abreast = {1: (0.0, 0.0, 0.0), 2: (0.0, 5.0, 0.0)}
    assert formation.closest(motion, abreast).distance_m == pytest.approx(5.0, rel=0.01)


def test_a_vehicle_that_cannot_keep_up_is_named() -> None:
    pair = chain(cooperative(), speed_m_s=2.0).closest([Harmonic(0.3, (8.0, 0.0, 0.0))], slots(4, 3.0))
    assert (pair.one_id, pair.distance_m) == (pair.other_id, 0.0)


@pytest.mark.parametrize("law", LAWS, ids=NAMES)
def test_the_named_pace_is_accepted_and_a_little_faster_is_not(law: NeighbourFeedback) -> None:
    chains, fast = [chain(law)], Harmonic(1.2, (8.0, 8.0, 0.0), rotates=True)
    assert too_close(chains, [[fast]], slots(4, 1.5), 1.0)
    refused = whole(refused_cases(chains, [[fast]], slots(4, 1.5), 1.0))
    times = whole(slower_by(refused, slots(4, 1.5), 1.0))
    assert 1.0 < times < inf
    assert too_close(chains, [[fast.slowed(times)]], slots(4, 1.5), 1.0) is None
    assert too_close(chains, [[fast.slowed(times * 0.97)]], slots(4, 1.5), 1.0)
