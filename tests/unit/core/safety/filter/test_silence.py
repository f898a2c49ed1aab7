"""The way on which a silent vehicle may be."""

from __future__ import annotations

from math import dist, exp

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.core.safety.filter.silence import COAST_1_S, nearest_on_way, velocity_after, with_kept_attitude
from companion.types.vectors import Vector3

BEGINS: Vector3 = (0.0, 0.0, 5.0)
EAST: Vector3 = (5.0, 0.0, 0.0)


def test_the_attitude_is_kept_at_first() -> None:
    assert with_kept_attitude((1.0, 2.0, 3.0), (4.0, -2.0, 9.0), 0.5) == pytest.approx((1.5, 1.75, 3.0))
    assert velocity_after((1.0, 2.0, 3.0), (4.0, -2.0, 9.0), 0.5) == pytest.approx((3.0, 1.0, 0.0))


def test_a_vehicle_behind_meets_the_beginning_of_the_way_which_rests() -> None:
    assert nearest_on_way((-3.0, 1.0, 5.0), BEGINS, EAST, 2.0) == (BEGINS, (0.0, 0.0, 0.0))


def test_a_vehicle_ahead_meets_the_end_of_the_way_which_still_moves() -> None:
    position, velocity = nearest_on_way((50.0, 1.0, 5.0), BEGINS, EAST, 2.0)
    assert position == pytest.approx((7.87, 0.0, 5.0), abs=0.01)
    assert velocity == pytest.approx((3.03, 0.0, 0.0), abs=0.01)


def test_a_vehicle_beside_the_way_meets_the_point_next_to_it() -> None:
    assert nearest_on_way((4.0, 2.0, 7.0), BEGINS, EAST, 2.0)[0] == pytest.approx((4.0, 0.0, 5.0))


def test_a_vehicle_at_rest_stays_where_it_is() -> None:
    assert nearest_on_way((4.0, 2.0, 7.0), BEGINS, (0.0, 0.0, 0.0), 500.0) == (BEGINS, (0.0, 0.0, 0.0))


METRES = st.floats(-50.0, 50.0)


@given(
    st.tuples(METRES, METRES, METRES),
    st.tuples(METRES, METRES, st.just(0.0)),
    st.floats(0.0, 600.0),
    st.floats(0.0, 1.0),
)
def test_no_place_on_the_way_is_nearer(own: Vector3, velocity: Vector3, coasts_s: float, share: float) -> None:
    nearest, _ = nearest_on_way(own, BEGINS, velocity, coasts_s)
    reach_s = share * (1.0 - exp(-COAST_1_S * coasts_s)) / COAST_1_S
    place = [p + reach_s * v for p, v in zip(BEGINS, velocity, strict=True)]
    assert dist(own, nearest) <= dist(own, place) + 1e-9
