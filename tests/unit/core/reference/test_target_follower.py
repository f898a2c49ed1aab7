"""Target follower: limits are kept for every target; a steady target is followed without lag."""

from __future__ import annotations

from math import cos, dist, hypot, sin

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.reference.target import LONGEST_S, Box, Room, TargetLimits, TargetPursuit, can_keep
from companion.geometry.airspace import Airspace, Cuboid, Cylinder, Fence
from companion.geometry.vectors import plus
from companion.types.formation import FormationState
from companion.types.values import ZERO3, Vector3

BOX: Box = ((-50.0, -20.0, 1.0), (50.0, 20.0, 30.0))
ROOM = Room(BOX)
LIMITS = TargetLimits(speed_m_s=3.0, acceleration_m_s2=1.0)
START = FormationState((0.0, 0.0, 5.0), ZERO3)
TICK_S = 0.02

metres = st.floats(-200.0, 200.0)
speeds = st.floats(-30.0, 30.0)
# An L with a slanting side, a mast and a shed, about two slots.
L_SHAPE = ((-40.0, -15.0), (45.0, -15.0), (45.0, 18.0), (12.0, 18.0), (8.0, 8.0), (-40.0, 8.0))
OBSTACLES = (Cylinder((20.0, -4.0), 2.0, 0.0, 15.0), Cuboid((-20.0, -6.0, 0.0), (-15.0, 0.0, 8.0)))
AIRSPACE = Airspace(Fence(*BOX, L_SHAPE), OBSTACLES, clearance_m=0.5)
SLOTS: tuple[Vector3, ...] = ((1.5, 0.0, 0.0), (-1.5, 0.0, 0.0))
WALLS = Room(((-48.0, -19.5, 1.5), (48.0, 19.5, 29.5)), AIRSPACE, SLOTS)  # the box less clearance and slots
targets = st.tuples(
    st.one_of(st.none(), st.tuples(metres, metres, metres)),
    st.tuples(speeds, speeds, speeds),
    st.floats(0.001, 1.0),  # seconds of a tick, or of a pause
    st.integers(1, 60),
)


@settings(deadline=None)
@given(st.lists(targets, min_size=1, max_size=12), st.floats(0.2, 15.0), st.floats(0.2, 6.0))
def test_limits_are_kept_for_every_target(
    steps: list[tuple[Vector3 | None, Vector3, float, int]], v: float, a: float
) -> None:
    limits = TargetLimits(v, a)
    pursuit = TargetPursuit(limits, START)
    for goal, velocity, dt_s, times in steps:
        for _ in range(times):
            before = pursuit.state
            pursuit.advance(dt_s, goal, velocity, ROOM)
            after, passed_s = pursuit.state, min(dt_s, LONGEST_S)
            assert hypot(*after.velocity_enu_m_s) <= v + 1e-9
            assert hypot(*after.acceleration_enu_m_s2) <= a + 1e-9
            assert dist(after.velocity_enu_m_s, before.velocity_enu_m_s) <= a * passed_s + 1e-9
            assert dist(after.position_enu_m, before.position_enu_m) <= v * passed_s + 1e-9
            assert all(lo - 1e-9 <= p <= hi + 1e-9 for p, lo, hi in zip(after.position_enu_m, *BOX, strict=True))


@settings(deadline=None, max_examples=30)
@given(st.lists(targets, min_size=1, max_size=12), st.floats(0.2, 15.0), st.floats(0.2, 6.0))
def test_no_target_leads_a_slot_out_of_the_polygon_or_into_an_obstacle(
    steps: list[tuple[Vector3 | None, Vector3, float, int]], v: float, a: float
) -> None:
    pursuit = TargetPursuit(TargetLimits(v, a), START)
    for goal, velocity, dt_s, times in steps:
        for _ in range(times):
            pursuit.advance(dt_s, goal, velocity, WALLS)
            at = pursuit.state.position_enu_m
            assert min(AIRSPACE.room_m(plus(at, slot)) for slot in SLOTS) > -1e-6


def led(target: Vector3, seconds: float = 60.0) -> TargetPursuit:
    """Where a target that stands still leads the RFT, without a step of its acceleration."""
    pursuit = TargetPursuit(LIMITS, START)
    for _ in range(round(seconds / TICK_S)):
        before = pursuit.state.acceleration_enu_m_s2
        pursuit.advance(TICK_S, target, ZERO3, WALLS)
        assert dist(pursuit.state.acceleration_enu_m_s2, before) < 0.3
    return pursuit


def test_a_target_beyond_the_polygon_is_awaited_at_the_polygon() -> None:
    assert led((-10.0, 15.0, 5.0)).state.position_enu_m == pytest.approx((-10.0, 7.5, 5.0), abs=0.05)


def test_a_target_behind_an_obstacle_is_awaited_before_it() -> None:
    at = led((-17.0, -3.0, 5.0)).state.position_enu_m
    assert at == pytest.approx((-13.0, -3.0, 5.0), abs=0.1)  # a slot of 1.5 m and the clearance east of the shed


def followed(seconds: float, velocity: Vector3, start: Vector3 = (4.0, -3.0, 5.0)) -> tuple[list[float], TargetPursuit]:
    """Distances to a target at constant velocity, and the follower."""
    pursuit, errors_m = TargetPursuit(LIMITS, START), []
    for tick in range(round(seconds / TICK_S)):
        t = tick * TICK_S
        goal = (start[0] + velocity[0] * t, start[1] + velocity[1] * t, start[2] + velocity[2] * t)
        pursuit.advance(TICK_S, goal, velocity, ROOM)
        errors_m.append(dist(pursuit.state.position_enu_m, goal) - TICK_S * hypot(*velocity))
    return errors_m, pursuit


@pytest.mark.parametrize("velocity", [ZERO3, (1.0, 0.0, 0.0), (-1.5, 0.4, 0.1)])
def test_steady_target_is_followed_without_lag(velocity: Vector3) -> None:
    errors_m, pursuit = followed(20.0, velocity)
    assert max(abs(error_m) for error_m in errors_m[-100:]) < 0.01
    assert pursuit.state.velocity_enu_m_s == pytest.approx(velocity, abs=0.01)


def test_no_overshoot_at_a_target_at_rest() -> None:
    goal = (10.0, 0.0, 5.0)
    pursuit, farthest_m = TargetPursuit(LIMITS, START), 0.0
    for _ in range(1500):
        pursuit.advance(TICK_S, goal, ZERO3, ROOM)
        farthest_m = max(farthest_m, pursuit.state.position_enu_m[0])
    assert farthest_m < 10.1
    assert pursuit.state.position_enu_m == pytest.approx(goal, abs=0.01)


def test_acceleration_has_no_step_inside_the_fence() -> None:
    """At most 2 degrees per tick."""
    pursuit = TargetPursuit(LIMITS, START)
    for tick in range(3000):
        before = pursuit.state.acceleration_enu_m_s2
        goal = (10.0 * cos(tick // 50), 10.0 * sin(tick // 50), 5.0)
        pursuit.advance(TICK_S, goal, (3.0 * sin(tick // 20), 0.0, 0.0), ROOM)
        assert dist(pursuit.state.acceleration_enu_m_s2, before) < 0.3


def test_target_outside_the_fence_is_followed_along_the_fence() -> None:
    pursuit = TargetPursuit(LIMITS, START)
    for tick in range(2000):
        before = pursuit.state.acceleration_enu_m_s2
        pursuit.advance(TICK_S, (-45.0 + 0.04 * tick, 60.0, -3.0), (2.0, 0.5, 0.0), ROOM)
        assert dist(pursuit.state.acceleration_enu_m_s2, before) < 0.3
    assert pursuit.state.position_enu_m[1:] == pytest.approx((20.0, 1.0), abs=0.02)
    assert pursuit.state.position_enu_m[0] == pytest.approx(-45.0 + 0.04 * 2000, abs=0.1)


def test_velocity_command_stops_at_the_fence_and_can_return() -> None:
    pursuit = TargetPursuit(LIMITS, START)
    for _ in range(2000):
        pursuit.advance(TICK_S, None, (0.0, 9.0, 0.0), ROOM)
    assert 19.5 < pursuit.state.position_enu_m[1] <= 20.0
    for _ in range(200):
        pursuit.advance(TICK_S, None, (0.0, -1.0, 0.0), ROOM)
    assert pursuit.state.velocity_enu_m_s[1] == pytest.approx(-1.0, abs=0.01)


def test_following_does_not_begin_when_braking_is_impossible() -> None:
    assert can_keep(START, LIMITS, ROOM)
    assert can_keep(FormationState((0.0, 0.0, 5.0), (3.0, 0.0, 0.0)), LIMITS, ROOM)
    assert not can_keep(FormationState((0.0, 0.0, 5.0), (3.1, 0.0, 0.0)), LIMITS, ROOM)
    assert not can_keep(FormationState((48.0, 0.0, 5.0), (3.0, 0.0, 0.0)), LIMITS, ROOM)
    assert not can_keep(FormationState((51.0, 0.0, 5.0), (1.0, 0.0, 0.0)), LIMITS, ROOM)
