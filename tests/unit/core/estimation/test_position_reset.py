"""Position resets are blended in at a limited rate."""

from itertools import pairwise
from math import dist

import pytest

from companion.core.estimation.corrections import LONGEST_GAP_S, RELEASE_M_S, PositionReset
from companion.types.values import Vector3

DT_S = 0.02


def flown(
    bumpless: PositionReset, begin_s: float, ticks: int, at: Vector3, velocity: Vector3 = (0.0, 0.0, 0.0)
) -> list[Vector3]:
    """Positions used for measured positions that begin `at` and move with this velocity."""
    used = []
    for tick in range(ticks):
        x, y, z = (a + v * tick * DT_S for a, v in zip(at, velocity, strict=True))
        used.append(bumpless.follow(begin_s + tick * DT_S, (x, y, z), velocity)[0])
    return used


def test_position_without_a_jump_is_used_unchanged() -> None:
    bumpless = PositionReset()
    used = flown(bumpless, 0.0, 100, (1.0, 2.0, 3.0), (5.0, -3.0, 1.0))
    assert used[-1] == pytest.approx((1.0 + 5.0 * 1.98, 2.0 - 3.0 * 1.98, 3.0 + 1.98))
    assert bumpless.held_back_m == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("jump", [(1.0, 0.0, 0.0), (-0.3, 0.4, 2.0)])
def test_jump_is_blended_in_at_the_limited_rate(jump: Vector3) -> None:
    bumpless = PositionReset()
    flown(bumpless, 0.0, 10, (0.0, 0.0, 0.0))
    used = flown(bumpless, 0.2, 600, jump)
    assert used[0] == (0.0, 0.0, 0.0)
    steps_m = [dist(a, b) for a, b in pairwise(used)]
    assert max(steps_m) <= RELEASE_M_S * DT_S * 1.001
    there = next(tick for tick, position in enumerate(used) if position == jump)
    assert there * DT_S == pytest.approx(dist(jump, (0.0, 0.0, 0.0)) / RELEASE_M_S, abs=0.05)


def test_jump_of_a_fast_vehicle_is_detected() -> None:
    bumpless = PositionReset()
    before = flown(bumpless, 0.0, 10, (0.0, 0.0, 0.0), (10.0, 0.0, 0.0))[-1]
    used, jump_m = bumpless.follow(10 * DT_S, (2.0 + 0.5, 0.0, 0.0), (10.0, 0.0, 0.0))
    assert jump_m == pytest.approx(0.5)
    assert used[0] - before[0] == pytest.approx(0.2)


def test_jump_and_return_leaves_no_offset() -> None:
    bumpless = PositionReset()
    flown(bumpless, 0.0, 2, (0.0, 0.0, 0.0))
    flown(bumpless, 0.04, 1, (50.0, 0.0, -2.0))
    assert bumpless.held_back_m == (-50.0, 0.0, 2.0)
    flown(bumpless, 0.06, 1, (0.0, 0.0, 0.0))
    assert bumpless.held_back_m == (0.0, 0.0, 0.0)


def test_hard_manoeuvre_is_no_jump() -> None:
    """10 m/s^2, with 25 Hz telemetry and a missing position."""
    bumpless = PositionReset()
    for step in range(20):
        time_s = step * 0.08
        speed = 10.0 * time_s
        _, jump_m = bumpless.follow(time_s, (0.5 * 10.0 * time_s**2, 0.0, 0.0), (speed, 0.0, 0.0))
        assert jump_m == 0.0


def test_position_is_used_at_once_after_a_long_gap() -> None:
    bumpless = PositionReset()
    flown(bumpless, 0.0, 2, (0.0, 0.0, 0.0))
    used, jump_m = bumpless.follow(0.02 + LONGEST_GAP_S + 0.01, (3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert used == (3.0, 0.0, 0.0)
    assert jump_m == 0.0
