"""`trimmed` drops the neighbours that differ most: by hand, and in eight ideal double integrators of which one lies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from math import cos, dist, pi, sin
from random import Random

import pytest

from companion.config.law import LawSection, law_problems
from companion.laws import FormationState, Neighbour, Own
from companion.laws.trimmed import Trimmed
from companion.types.values import ZERO3, Vector3

LAW = Trimmed(feedforward=0.9)
AT_ORIGIN = Own(ZERO3, ZERO3)


def at(*position_m: float, v: Vector3 = ZERO3, a: Vector3 = ZERO3, prc: int = 1) -> Neighbour:
    x, y, z = (*position_m, 0.0, 0.0, 0.0)[:3]
    return Neighbour((x, y, z), v, a, prc)


def toward(*position_m: float) -> Vector3:
    return pytest.approx(tuple(LAW.position_gain_1_s2 * p for p in position_m))


def u(*neighbours: Neighbour, own: Own = AT_ORIGIN, law: Trimmed = LAW) -> Vector3:
    return law.acceleration(own, neighbours, None)


def test_the_neighbour_that_differs_most_from_the_others_is_dropped() -> None:
    assert u(at(1.0), at(-3.0), at(0.8, 0.2)) == toward(0.9, 0.1, 0.0)  # although the own state is at 0
    assert u(at(1.0), at(-3.0), at(0.5), at(0.6), law=Trimmed(most_liars=0, feedforward=0.9)) == toward(
        -0.225, 0.0, 0.0
    )


@pytest.mark.parametrize("lie", [{"v": (0.0, -2.0, 0.0)}, {"a": (0.0, 0.0, 3.0)}])
def test_a_false_velocity_or_acceleration_drops_a_neighbour_as_a_whole(lie: dict[str, Vector3]) -> None:
    assert u(at(0.6), at(0.4), at(0.5, **lie)) == toward(0.5, 0.0, 0.0)


def test_what_is_dropped_turns_with_the_frame() -> None:
    # By the component x the first differs most from the others, by the norm the third.
    vectors = (1.0, 0.0), (0.2, 0.0), (0.3, 0.9)
    c, s = cos(pi / 3.0), sin(pi / 3.0)
    turned = [(c * x - s * y, s * x + c * y) for x, y in vectors]
    assert u(*[at(*v) for v in vectors]) == toward(0.6, 0.0, 0.0)
    assert u(*[at(*v) for v in turned]) == toward(0.6 * c, 0.6 * s, 0.0)


def test_the_neighbours_nearest_to_a_leader_count() -> None:
    near, far = [at(0.1, prc=1), at(0.1, prc=2), at(0.3, prc=2)], [at(0.0, 5.0, prc=3), at(0.0, -7.0, prc=8)]
    assert u(*near, *far) == toward(0.1, 0.0, 0.0)
    assert LAW.weights(False, [1, 3, 2, 2, 8]) == pytest.approx([1 / 3, 0.0, 1 / 3, 1 / 3, 0.0])
    assert LAW.weights(False, [3, 3, 3, 2]) == pytest.approx([0.25] * 4)  # none is nearer than another
    assert LAW.weights(True, [2, 2]) == ()


def test_with_two_neighbours_nobody_can_tell_who_lies() -> None:
    assert u(at(1.0), at(-3.0)) == toward(-1.0, 0.0, 0.0)
    assert u(at(1.0)) == toward(1.0, 0.0, 0.0)
    assert u() == ZERO3


def test_two_liars_are_dropped_of_five_and_one_of_four() -> None:
    law = Trimmed(most_liars=2, feedforward=0.9)
    honest, liars = (at(0.1), at(0.2), at(0.3)), (at(0.0, 9.0), at(0.0, 9.0))
    assert u(*honest, *liars, law=law) == toward(0.2, 0.0, 0.0)
    assert u(*honest, liars[0], law=law) == toward(0.2, 0.0, 0.0)


def test_a_leader_follows_its_reference_alone() -> None:
    reference = FormationState((1.0, 0.0, 0.0), ZERO3, (0.5, 0.0, 0.0))
    own = Own(ZERO3, ZERO3, drag_1_s=0.2)
    assert LAW.acceleration(own, [at(0.0, 5.0)], reference) == pytest.approx((2.0 + 0.9 * 0.5, 0.0, 0.0))


def test_the_law_pulls_back_to_one_neighbour() -> None:
    assert list(law_problems(LawSection(name="trimmed"), "law")) == []


# Leaders 1 to 3; 4 to 6 hear these, and 7 and 8 hear 4 to 6. Edges have two directions.
HEARD = dict.fromkeys((1, 2, 3, 7, 8), (4, 5, 6)) | dict.fromkeys((4, 5, 6), (1, 2, 3, 7, 8))
PRC = {1: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 2, 7: 3, 8: 3}
LIAR = 5
STEP_S, LASTS = 0.05, 500


def reference_at(t: float) -> FormationState:
    """A circle of 6 m in 30 s."""
    r, w = 6.0, 2.0 * pi / 30.0
    c, s = r * cos(w * t), r * sin(w * t)
    return FormationState((c, s, 0.0), (-s * w, c * w, 0.0), (-c * w * w, -s * w * w, 0.0))


States = Mapping[int, FormationState]
Lie = Callable[[States, float], FormationState]
"""What all know of themselves, and the time -> what the liar says."""


def drifting(speed_m_s: float) -> Lie:
    def told(known: States, t: float) -> FormationState:
        (x, y, z), (vx, vy, vz) = known[LIAR].position_enu_m, known[LIAR].velocity_enu_m_s
        return FormationState((x, y + speed_m_s * t, z), (vx, vy + speed_m_s, vz), known[LIAR].acceleration_enu_m_s2)

    return told


def pushing(known: States, t: float) -> FormationState:  # noqa: ARG001
    (x, y, z) = known[LIAR].acceleration_enu_m_s2
    return FormationState(known[LIAR].position_enu_m, known[LIAR].velocity_enu_m_s, (x, y + 3.0, z))


def luring(known: States, t: float) -> FormationState:  # noqa: ARG001
    """A little nearer to its victim than the farthest honest neighbour of that is, on the other side."""
    victim = known[7]
    (x, y, z), position_m = victim.position_enu_m, [known[j].position_enu_m for j in (4, 6)]
    ahead_m = 0.99 * max(dist(p, victim.position_enu_m) for p in position_m)
    return FormationState((x, y + ahead_m, z), victim.velocity_enu_m_s, victim.acceleration_enu_m_s2)


def largest_error_m(law: Trimmed, lie: Lie) -> float:
    """Of all that do not lie. Each knows its own state, and sends it, with an error of 3 cm and 3 cm/s."""
    random, first = Random(7), reference_at(0.0)
    states = dict.fromkeys(HEARD, FormationState(first.position_enu_m, first.velocity_enu_m_s))
    largest_m = 0.0
    for k in range(LASTS):
        reference = reference_at(k * STEP_S)
        known = {i: _noisy(state, random) for i, state in states.items()}
        sent = known | {LIAR: lie(known, k * STEP_S)}
        for i, heard in HEARD.items():
            own = Own(known[i].position_enu_m, known[i].velocity_enu_m_s)
            others = [
                Neighbour(s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2, PRC[j])
                for j in heard
                for s in [sent[j]]
            ]
            states[i] = _moved(states[i], law.acceleration(own, others, reference if i <= 3 else None))
        after = reference_at((k + 1) * STEP_S).position_enu_m
        largest_m = max(largest_m, *[dist(s.position_enu_m, after) for i, s in states.items() if i != LIAR])
    return largest_m


def _noisy(state: FormationState, random: Random) -> FormationState:
    x, y, z = [p + random.gauss(0.0, 0.03) for p in state.position_enu_m]
    vx, vy, vz = [v + random.gauss(0.0, 0.03) for v in state.velocity_enu_m_s]
    return FormationState((x, y, z), (vx, vy, vz), state.acceleration_enu_m_s2)


def _moved(state: FormationState, u: Vector3) -> FormationState:
    (x, y, z), (vx, vy, vz), (ax, ay, az), dt = state.position_enu_m, state.velocity_enu_m_s, u, STEP_S
    half = 0.5 * dt * dt
    position_m = (x + vx * dt + ax * half, y + vy * dt + ay * half, z + vz * dt + az * half)
    return FormationState(position_m, (vx + ax * dt, vy + ay * dt, vz + az * dt), u)


LIES = {"slow": drifting(0.05), "walking": drifting(0.3), "fast": drifting(2.0), "pushing": pushing, "luring": luring}


@pytest.mark.parametrize("lie", LIES.values(), ids=LIES)
def test_no_liar_draws_an_honest_vehicle_off(lie: Lie) -> None:
    assert largest_error_m(Trimmed(), lie) < 0.1


@pytest.mark.parametrize("name", ["slow", "walking", "fast", "pushing"])
def test_the_mean_of_all_neighbours_is_drawn_off(name: str) -> None:
    assert largest_error_m(Trimmed(most_liars=0), LIES[name]) > 0.3


class FromOwnState(Trimmed, frozen=True):
    """Drops what differs most from the own state."""

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        near = [n for n, w in zip(neighbours, self.weights(False, [n.prc for n in neighbours]), strict=True) if w]
        kept = sorted(near, key=lambda n: dist(n.position_enu_m, own.position_enu_m))[: len(near) - 1]
        return Trimmed(most_liars=0).acceleration(own, kept, reference)


def test_differences_from_the_own_state_would_let_a_liar_lure_a_vehicle_away() -> None:
    assert largest_error_m(FromOwnState(), luring) > 0.3
