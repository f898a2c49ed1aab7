"""Speed limit, fence and obstacles as limits of the acceleration: a lagged double integrator flown against them."""

from __future__ import annotations

from collections import deque
from math import cos, hypot, inf, radians, sin, tan

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from companion.core.filter.filter import Bounds, SpeedLimit
from companion.core.filter.motion import Ahead, Motions, Silence
from companion.core.filter.solver import AccelerationLimits, filter_acceleration
from companion.geometry.airspace import Airspace, Cuboid, Cylinder, Fence
from companion.types.autopilot import VehicleState
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

TAN_TILT = tan(radians(25.0))
LIMITS = AccelerationLimits.of_envelope(TAN_TILT, 0.3, 1.6)
SPEED = SpeedLimit(12.0, 3.0, 2.0)
U_SHAPE = (
    (-60.0, -40.0),
    (60.0, -40.0),
    (60.0, 40.0),
    (20.0, 40.0),
    (20.0, 0.0),
    (-20.0, 0.0),
    (-20.0, 40.0),
    (-60.0, 40.0),
)
TREE, HOUSE = Cylinder((-40.0, 10.0), 3.0, 0.0, 12.0), Cuboid((30.0, -20.0, 0.0), (40.0, -10.0, 10.0))
POLE = Cylinder((0.0, -25.0), 0.2, -5.0, 50.0)
FENCE = Fence((-100.0, -100.0, 0.0), (100.0, 100.0, 30.0), U_SHAPE)
AIRSPACE = Airspace(FENCE, (TREE, HOUSE, POLE), clearance_m=0.5)
BOUNDS = Bounds(AIRSPACE, SPEED, 0.5 * GRAVITY_M_S2 * TAN_TILT, 0.5 * GRAVITY_M_S2 * 0.6, 2.0)
DEEPEST_M = 0.1  # into the clearance, in the flights below
TICK_S, STEP_S, DELAY_TICKS = 0.02, 0.005, 2


class Flown:
    """Result of a flight: the least room, with the clearance taken off, and the largest speeds."""

    def __init__(self) -> None:
        self.room_m, self.level_m_s, self.climb_m_s, self.descent_m_s = inf, 0.0, 0.0, 0.0


def fly(position: Vector3, wanted: list[Vector3], lag_s: float, each_s: float = 2.0) -> Flown:
    """A vehicle with attitude lag and 40 ms of transport delay, from rest, on which a law pulls that knows no limits."""
    x, v, a = list(position), [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]
    motions, flown, command, waiting = (
        Motions(1, Silence(0.3, 0.0, 1.0, 2.0)),
        Flown(),
        ZERO3,
        deque([ZERO3] * DELAY_TICKS),
    )
    for tick in range(round(each_s * len(wanted) / TICK_S)):
        now_s = tick * TICK_S
        state = VehicleState(
            position_enu_m=(x[0], x[1], x[2]), velocity_enu_m_s=(v[0], v[1], v[2]), position_time_s=now_s
        )
        ahead = motions.own(now_s, state, command)
        slowed, speed = BOUNDS.limit_speed(ahead, wanted[int(now_s / each_s)])
        command = LIMITS.limit(filter_acceleration(slowed, BOUNDS.constraints(ahead, None) + speed, LIMITS))
        waiting.append(command)
        arrived = waiting.popleft()
        for _ in range(round(TICK_S / STEP_S)):
            for axis in range(3):
                a[axis] += (arrived[axis] - a[axis]) * STEP_S / lag_s
                v[axis] += a[axis] * STEP_S
                x[axis] += v[axis] * STEP_S
        flown.room_m = min(flown.room_m, AIRSPACE.room_m((x[0], x[1], x[2])))
        flown.level_m_s = max(flown.level_m_s, hypot(v[0], v[1]))
        flown.climb_m_s, flown.descent_m_s = max(flown.climb_m_s, v[2]), max(flown.descent_m_s, -v[2])
    return flown


pulls = st.tuples(st.floats(-6.0, 6.0), st.floats(-6.0, 6.0), st.floats(-5.0, 5.0))
starts = st.tuples(st.floats(-59.0, 59.0), st.floats(-39.0, 39.0), st.floats(1.0, 29.0)).filter(
    lambda p: AIRSPACE.room_m(p) >= 0.0
)


@settings(max_examples=60, deadline=None)
@given(starts, st.lists(pulls, min_size=3, max_size=8), st.floats(0.1, 0.25))
def test_no_pull_brings_a_vehicle_into_the_clearance_or_above_its_speed(
    start: Vector3, wanted: list[Vector3], lag_s: float
) -> None:
    flown = fly(start, wanted, lag_s)
    assert flown.room_m > -DEEPEST_M
    assert flown.level_m_s < SPEED.level_m_s * 1.02
    assert flown.climb_m_s < SPEED.climb_m_s * 1.05
    assert flown.descent_m_s < SPEED.descent_m_s * 1.05


def test_a_vehicle_stops_before_a_corner_of_two_walls_and_the_top() -> None:
    pulls: list[Vector3] = [(0, -2, 3), (0, 2, 0), (0, 3, -1.5), (0, 0, 1), (3, 0, 0), (1, 0, 0), (0, 0, 0)]
    assert -DEEPEST_M < fly((23.0, 1.0, 5.0), pulls, 0.25).room_m < 0.5


@pytest.mark.parametrize("start_m", [46.0, 48.0, 50.0])
def test_a_vehicle_gives_up_a_dive_to_stop_before_a_corner_of_two_walls(start_m: float) -> None:
    """It flies into the corner, then a law pulls back and down: a dive leaves less thrust to tilt than two walls ask for."""
    flown = fly((start_m, start_m - 20.0, 16.0), [(6.0, 6.0, 5.0), (-6.0, -6.0, -5.0)], 0.25)
    assert -DEEPEST_M < flown.room_m < 0.5


@pytest.mark.parametrize("angle_deg", [0, 40, 90, 135, 180, 225, 270, 315])
def test_a_vehicle_at_full_speed_stops_before_the_boundary(angle_deg: int) -> None:
    pull = (6.0 * cos(radians(angle_deg)), 6.0 * sin(radians(angle_deg)), 0.0)
    flown = fly((0.0, -20.0, 15.0), [pull] * 10, 0.2)
    assert -DEEPEST_M < flown.room_m < 0.5  # it reaches the boundary, and stays out of it


@pytest.mark.parametrize("back_m_s2", [2.0, 3.0, 4.0])
def test_a_pull_sideways_beyond_the_tilt_limit_takes_no_braking_away(back_m_s2: float) -> None:
    """As much as a law wants far from its goal: it would brake before the wall, but the limit leaves a part of it only."""
    pulls: list[Vector3] = [(6.0, 0.0, 0.0), (-back_m_s2, -30.0, 0.0), (-back_m_s2, -7.5, 0.0)]
    assert fly((40.0, 20.0, 15.0), pulls, 0.25).room_m > -DEEPEST_M


def test_a_command_far_from_all_limits_is_the_same_object() -> None:
    ahead = Ahead((0.0, -20.0, 15.0), (2.0, 1.0, 0.5))
    wanted = (0.1234567, -0.7654321, 0.3)
    slowed, speed = BOUNDS.limit_speed(ahead, wanted)
    assert slowed is wanted
    assert filter_acceleration(wanted, BOUNDS.constraints(ahead, None) + speed, LIMITS) is wanted


def test_above_the_speed_limit_the_vehicle_is_slowed_down() -> None:
    slowed, _ = BOUNDS.limit_speed(Ahead(ZERO3, (15.0, 0.0, 4.0)), (3.0, 1.0, 2.0))
    assert slowed == (-6.0, 1.0, -2.0)


def test_a_vehicle_outside_the_fence_is_brought_back_slowly() -> None:
    ahead = Ahead((0.0, 3.0, 15.0), ZERO3)  # in the notch
    x, y, z = filter_acceleration(ZERO3, BOUNDS.constraints(ahead, None), LIMITS)
    assert (x, z) == (pytest.approx(0.0, abs=1e-5), pytest.approx(0.0, abs=1e-5))
    assert y < -1.0
