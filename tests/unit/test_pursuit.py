"""An RFT that follows a target: whatever that does, no limit is passed; what moves steadily is followed without lag."""

from __future__ import annotations

from math import cos, dist, hypot, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.formation import Place
from companion.core.pursuit import LONGEST_S, Box, Pursuit, PursuitLimits, can_keep
from companion.types import ZERO3, Vector3

BOX: Box = ((-50.0, -20.0, 1.0), (50.0, 20.0, 30.0))
LIMITS = PursuitLimits(speed_m_s=3.0, acceleration_m_s2=1.0)
START = Place((0.0, 0.0, 5.0), ZERO3)
TICK_S = 0.02

metres = st.floats(-200.0, 200.0)
speeds = st.floats(-30.0, 30.0)
targets = st.tuples(
    st.one_of(st.none(), st.tuples(metres, metres, metres)),
    st.tuples(speeds, speeds, speeds),
    st.floats(0.001, 1.0),  # seconds of a tick, or of a pause
    st.integers(1, 60),
)


@settings(deadline=None)
@given(st.lists(targets, min_size=1, max_size=12), st.floats(0.2, 15.0), st.floats(0.2, 6.0))
def test_no_target_makes_it_pass_a_limit(
    told: list[tuple[Vector3 | None, Vector3, float, int]], v: float, a: float
) -> None:
    limits = PursuitLimits(v, a)
    pursuit = Pursuit(limits, START)
    for goal, velocity, dt_s, times in told:
        for _ in range(times):
            before = pursuit.place
            pursuit.advance(dt_s, goal, velocity, BOX)
            after, passed_s = pursuit.place, min(dt_s, LONGEST_S)
            assert hypot(*after.velocity_enu_m_s) <= v + 1e-9
            assert hypot(*after.acceleration_enu_m_s2) <= a + 1e-9
            assert dist(after.velocity_enu_m_s, before.velocity_enu_m_s) <= a * passed_s + 1e-9
            assert dist(after.position_enu_m, before.position_enu_m) <= v * passed_s + 1e-9
            assert all(lo - 1e-9 <= p <= hi + 1e-9 for p, lo, hi in zip(after.position_enu_m, *BOX, strict=True))


def followed(seconds: float, velocity: Vector3, start: Vector3 = (4.0, -3.0, 5.0)) -> tuple[list[float], Pursuit]:
    """Distances to a target that moves steadily, and what follows it."""
    pursuit, errors_m = Pursuit(LIMITS, START), []
    for tick in range(round(seconds / TICK_S)):
        t = tick * TICK_S
        goal = (start[0] + velocity[0] * t, start[1] + velocity[1] * t, start[2] + velocity[2] * t)
        pursuit.advance(TICK_S, goal, velocity, BOX)
        errors_m.append(dist(pursuit.place.position_enu_m, goal) - TICK_S * hypot(*velocity))
    return errors_m, pursuit


@pytest.mark.parametrize("velocity", [ZERO3, (1.0, 0.0, 0.0), (-1.5, 0.4, 0.1)])
def test_what_moves_steadily_is_reached_and_followed_without_lag(velocity: Vector3) -> None:
    errors_m, pursuit = followed(20.0, velocity)
    assert max(abs(error_m) for error_m in errors_m[-100:]) < 0.01
    assert pursuit.place.velocity_enu_m_s == pytest.approx(velocity, abs=0.01)


def test_it_does_not_swing_about_a_target_that_stands() -> None:
    goal = (10.0, 0.0, 5.0)
    pursuit, farthest_m = Pursuit(LIMITS, START), 0.0
    for _ in range(1500):
        pursuit.advance(TICK_S, goal, ZERO3, BOX)
        farthest_m = max(farthest_m, pursuit.place.position_enu_m[0])
    assert farthest_m < 10.1
    assert pursuit.place.position_enu_m == pytest.approx(goal, abs=0.01)


def test_its_acceleration_never_steps_in_open_air() -> None:
    """2 degrees at most in a tick, whatever the target does."""
    pursuit = Pursuit(LIMITS, START)
    for tick in range(3000):
        before = pursuit.place.acceleration_enu_m_s2
        goal = (10.0 * cos(tick // 50), 10.0 * sin(tick // 50), 5.0)
        pursuit.advance(TICK_S, goal, (3.0 * sin(tick // 20), 0.0, 0.0), BOX)
        assert dist(pursuit.place.acceleration_enu_m_s2, before) < 0.3


def test_a_target_outside_the_fence_is_followed_along_it_as_smoothly() -> None:
    pursuit = Pursuit(LIMITS, START)
    for tick in range(2000):
        before = pursuit.place.acceleration_enu_m_s2
        pursuit.advance(TICK_S, (-45.0 + 0.04 * tick, 60.0, -3.0), (2.0, 0.5, 0.0), BOX)
        assert dist(pursuit.place.acceleration_enu_m_s2, before) < 0.3
    assert pursuit.place.position_enu_m[1:] == pytest.approx((20.0, 1.0), abs=0.02)
    assert pursuit.place.position_enu_m[0] == pytest.approx(-45.0 + 0.04 * 2000, abs=0.1)


def test_a_joystick_pushed_towards_the_fence_ends_before_it_and_is_free_to_come_back() -> None:
    pursuit = Pursuit(LIMITS, START)
    for _ in range(2000):
        pursuit.advance(TICK_S, None, (0.0, 9.0, 0.0), BOX)
    assert 19.5 < pursuit.place.position_enu_m[1] <= 20.0
    for _ in range(200):
        pursuit.advance(TICK_S, None, (0.0, -1.0, 0.0), BOX)
    assert pursuit.place.velocity_enu_m_s[1] == pytest.approx(-1.0, abs=0.01)


def test_from_where_it_cannot_be_braked_any_more_none_begins() -> None:
    assert can_keep(START, LIMITS, BOX)
    assert can_keep(Place((0.0, 0.0, 5.0), (3.0, 0.0, 0.0)), LIMITS, BOX)
    assert not can_keep(Place((0.0, 0.0, 5.0), (3.1, 0.0, 0.0)), LIMITS, BOX)
    assert not can_keep(Place((48.0, 0.0, 5.0), (3.0, 0.0, 0.0)), LIMITS, BOX)
    assert not can_keep(Place((51.0, 0.0, 5.0), (1.0, 0.0, 0.0)), LIMITS, BOX)
