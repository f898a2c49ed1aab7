"""The velocity agrees with the change of the position, whatever the estimator reports."""

from __future__ import annotations

from math import cos, dist, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.estimation.corrections import LARGEST_M_S, LONGEST_GAP_S, VelocityCorrection
from companion.types.values import ZERO3, Vector3

DT_S = 0.02


def hover(correction: VelocityCorrection, error_m_s: Vector3, seconds: float, begin_s: float = 0.0) -> Vector3:
    """The velocity used at the end of a hover with this error of the reported velocity."""
    used = ZERO3
    for tick in range(int(seconds / DT_S) + 1):
        used = correction.follow(begin_s + tick * DT_S, (1.0, 2.0, 3.0), error_m_s)
    return used


@pytest.mark.parametrize("bandwidth_1_s", [0.5, 2.0, 3.0, 5.0, 10.0])
def test_a_constant_error_of_the_velocity_is_removed(bandwidth_1_s: float) -> None:
    error_m_s = (0.025, -0.3, 0.1)
    correction = VelocityCorrection(bandwidth_1_s)
    assert hover(correction, error_m_s, 12.0 / bandwidth_1_s) == pytest.approx(ZERO3, abs=1e-3)


def test_a_consistent_motion_is_unchanged() -> None:
    correction = VelocityCorrection(2.0)
    for tick in range(500):
        t = tick * DT_S
        velocity = (cos(t), -2.0 * sin(2.0 * t), 0.5)
        used = correction.follow(t, (sin(t), cos(2.0 * t), 0.5 * t), velocity)
        assert used == pytest.approx(velocity, abs=2e-3)  # of the trapezoid over 20 ms


def test_the_fast_part_of_the_velocity_is_kept() -> None:
    """The noise of the position between two ticks is no velocity."""
    correction = VelocityCorrection(2.0)
    used = [correction.follow(tick * DT_S, (0.01 * (-1) ** tick, 0.0, 0.0), ZERO3) for tick in range(500)]
    assert max(dist(velocity, ZERO3) for velocity in used) < 0.02


def test_a_jump_of_the_position_is_no_velocity() -> None:
    correction = VelocityCorrection(2.0)
    hover(correction, (0.1, 0.0, 0.0), 10.0)
    used = [correction.follow(10.02 + tick * DT_S, (3.0, 2.0, 3.0), (0.1, 0.0, 0.0)) for tick in range(100)]
    assert max(dist(velocity, ZERO3) for velocity in used) < 2e-3


def test_after_a_gap_and_a_restart_it_begins_without_a_correction() -> None:
    correction = VelocityCorrection(2.0)
    hover(correction, (0.1, 0.0, 0.0), 10.0)
    assert correction.follow(10.0 + LONGEST_GAP_S + 0.1, (1.0, 2.0, 3.0), (0.1, 0.0, 0.0)) == (0.1, 0.0, 0.0)
    hover(correction, (0.1, 0.0, 0.0), 10.0, 20.0)
    correction.restart()
    assert correction.follow(30.02, (1.0, 2.0, 3.0), (0.1, 0.0, 0.0)) == (0.1, 0.0, 0.0)


@given(
    st.lists(
        st.tuples(
            st.floats(1e-3, 2.0),
            st.tuples(*[st.floats(-1e5, 1e5)] * 3),
            st.tuples(*[st.floats(-100.0, 100.0)] * 3),
        ),
        max_size=40,
    ),
    st.floats(0.01, 10.0),
)
def test_the_correction_is_bounded_whatever_is_reported(
    samples: list[tuple[float, Vector3, Vector3]], bandwidth_1_s: float
) -> None:
    correction, time_s = VelocityCorrection(bandwidth_1_s), 0.0
    for step_s, position_m, velocity_m_s in samples:
        time_s += step_s
        used = correction.follow(time_s, position_m, velocity_m_s)
        assert dist(used, velocity_m_s) <= LARGEST_M_S * 1.0001
