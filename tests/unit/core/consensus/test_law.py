"""Eq. 14, 22 and 26 against hand-computed values, and the platoon of an ideal double integrator."""

import pytest

from companion.core.consensus.law import formation_state, next_prc
from companion.core.reference.blend import point
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.types.formation import FlownSlot, FormationState, Gains
from companion.types.values import ZERO3
from tests.helpers.laws import acceleration, average_22, average_26, law_of, weighted

K = Gains(1.39, 1.2)
REST = (0.0, 0.0, 0.0)


def at(x: float, vx: float = 0.0) -> FormationState:
    return FormationState((x, 0.0, 0.0), (vx, 0.0, 0.0))


def accelerating(acceleration: float) -> FormationState:
    return FormationState((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (acceleration, 0.0, 0.0))


def test_equation_14_of_a_follower() -> None:
    # Neighbours with PrC 1 and 3: weights 3/4 and 1/4. z = 3/4 (2 - 1) + 1/4 (2 - 4) = 0.25 m; velocity 0.5 m/s.
    u = acceleration(weighted(K, 1.0), at(2.0, 0.5), [(1, at(1.0)), (3, at(4.0))], None)
    assert u == pytest.approx((-1.39 * 0.25 - 1.2 * 0.5, 0.0, 0.0))


def test_equation_14_of_a_leader() -> None:
    # z = (0 - 0.5) + (0 - 1) = -1.5 m: the reference counts as one more neighbour.
    u = acceleration(weighted(K, 1.0), at(0.0), [(2, at(0.5))], at(1.0))
    assert u == pytest.approx((1.39 * 1.5, 0.0, 0.0))


def test_equation_26_leader_uses_the_reference_alone() -> None:
    u = acceleration(average_26(K), at(0.0), [(2, at(0.5))], at(1.0))
    assert u == pytest.approx((1.39, 0.0, 0.0))


def test_equation_26_follower_uses_the_average() -> None:
    u = acceleration(average_26(K), at(0.0), [(1, at(1.0)), (3, at(-2.0))], None)
    assert u == pytest.approx((-1.39 * 0.5, 0.0, 0.0))


def test_acceleration_is_zero_for_a_follower_without_neighbours() -> None:
    assert acceleration(weighted(K, 1.0), at(3.0, 1.0), [], None) == (0.0, 0.0, 0.0)


def test_acceleration_is_zero_in_perfect_formation() -> None:
    assert formation_state((2.0, 3.0, 1.0), REST, FlownSlot((1.0, 3.0, 0.0))) == FormationState((1.0, 0.0, 1.0), REST)


def test_feedforward_uses_the_same_weights() -> None:
    law = law_of(K, 1.0, True, 0.8)
    neighbours = [(1, accelerating(1.0)), (3, accelerating(-2.0))]  # weights 3/4 and 1/4
    assert acceleration(law, at(0.0), neighbours, None) == pytest.approx((0.8 * 0.25, 0.0, 0.0))


def test_leader_feeds_forward_its_reference_only() -> None:
    law = law_of(K, 1.0, True, 0.8)
    u = acceleration(law, at(0.0), [(2, accelerating(5.0))], accelerating(0.5))
    assert u == pytest.approx((0.8 * 0.5, 0.0, 0.0))


def test_leader_feeds_forward_its_drag_along_the_reference() -> None:
    law = law_of(K, 1.0, False, 0.8)
    moving = FormationState(ZERO3, (2.0, 0.0, -1.0), (0.5, 0.0, 0.0))
    on_it = FormationState(ZERO3, (2.0, 0.0, -1.0))
    u = acceleration(law, on_it, [], moving, drag_1_s=0.3)
    assert u == pytest.approx((0.8 * (0.5 + 0.3 * 2.0), 0.0, 0.8 * 0.3 * -1.0))


def test_laws_of_the_paper_have_no_feedforward() -> None:
    neighbours = [(1, accelerating(5.0))]
    for law in (weighted(), average_22(), average_26()):
        assert acceleration(law, at(0.0), neighbours, None) == (0.0, 0.0, 0.0)
        assert acceleration(law, at(0.0), [], accelerating(5.0), drag_1_s=0.3) == (0.0, 0.0, 0.0)


def fly_platoon(law: NeighbourFeedback, seconds: float = 100.0) -> tuple[list[float], float]:
    """Largest distances and settling time (10 cm) of ideal double integrators at 50 Hz."""
    n, dt = 4, 0.02
    x, v, prcs = [0.0, -1.5, -3.0, -4.5], [0.0] * n, [1, n, n, n]
    slots = [(-1.5 * i, 0.0, 0.0) for i in range(n)]
    reference = point((1.0, 0.0, 0.0))
    largest, settled_s = [0.0] * (n - 1), 0.0
    for k in range(int(seconds / dt)):
        places = [formation_state((x[i], 0.0, 0.0), (v[i], 0.0, 0.0), FlownSlot(slots[i])) for i in range(n)]
        near = [[j for j in (i - 1, i + 1) if 0 <= j < n] for i in range(n)]
        prcs = [next_prc(i == 0, (prcs[j] for j in near[i]), n) for i in range(n)]
        for i in range(n):
            r = reference(k * dt) if i == 0 else None
            u = acceleration(law, places[i], [(prcs[j], places[j]) for j in near[i]], r)[0]
            x[i] += v[i] * dt + 0.5 * u * dt * dt
            v[i] += u * dt
        largest = [max(d, x[i] - x[i + 1]) for i, d in enumerate(largest)]
        if max(abs(x[i] - 1.0 - slots[i][0]) for i in range(n)) > 0.1:
            settled_s = (k + 1) * dt
    return largest, settled_s


@pytest.mark.parametrize(
    ("law", "largest_m", "settled_s"),
    [
        (average_22(K), [1.82, 1.73, 1.59], 49.9),
        (average_26(K), [2.03, 1.86, 1.64], 31.3),
        (weighted(K, 1.0), [1.75, 1.77, 1.66], 25.9),
    ],
)
def test_the_platoon_of_ideal_vehicles(law: NeighbourFeedback, largest_m: list[float], settled_s: float) -> None:
    largest, settled = fly_platoon(law)
    assert largest == pytest.approx(largest_m, abs=0.01)
    assert settled == pytest.approx(settled_s, abs=0.4)


def test_a_leader_that_follows_the_reference_alone_uses_no_weights() -> None:
    assert average_26().weights(True, [2, 2]) == ()
    assert average_26().weights(False, [1, 3]) == (0.5, 0.5)
    assert weighted().weights(True, [1, 3]) == pytest.approx([0.75, 0.25])
