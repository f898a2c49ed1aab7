"""Limits of scalars."""

from math import inf

from hypothesis import given
from hypothesis import strategies as st

from companion.geometry.vectors import between, clamped

NUMBER = st.floats(allow_nan=False)


@given(NUMBER, NUMBER, NUMBER)
def test_the_upper_limit_counts_where_limits_contradict_each_other(value: float, low: float, high: float) -> None:
    assert between(value, low, high) == min(max(value, low), high)


@given(NUMBER, st.floats(0.0, inf))
def test_a_value_is_clamped_on_both_sides(value: float, limit: float) -> None:
    assert clamped(value, limit) == min(max(value, -limit), limit)
