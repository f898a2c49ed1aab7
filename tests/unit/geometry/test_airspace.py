"""Distances to fence and obstacles, polygons, and paths in the airspace."""

from __future__ import annotations

from math import cos, dist, hypot, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry.airspace import (
    Airspace,
    Cuboid,
    Cylinder,
    Fence,
    Obstacle,
    area_m2,
    conflict_steps,
    crossing_sides,
    in_polygon,
    leg_conflict_steps,
)
from companion.types.steps import whole
from companion.types.values import Vector3

U_SHAPE = ((0.0, 0.0), (30.0, 0.0), (30.0, 20.0), (20.0, 20.0), (20.0, 10.0), (10.0, 10.0), (10.0, 20.0), (0.0, 20.0))
FENCE = Fence((-5.0, -5.0, 0.0), (40.0, 30.0, 12.0), U_SHAPE)
MAST = Cylinder((5.0, -3.0), 2.0, 0.0, 8.0)
HOUSE = Cuboid((-4.0, 2.0, 0.0), (3.0, 9.0, 5.0))
positions = st.tuples(st.floats(-20.0, 40.0), st.floats(-20.0, 40.0), st.floats(-5.0, 20.0))


@given(positions, positions)
@pytest.mark.parametrize("body", [MAST, HOUSE], ids=["cylinder", "box"])
def test_a_distance_changes_no_faster_than_the_position(body: Obstacle, a: Vector3, b: Vector3) -> None:
    assert abs(body.gap(a)[0] - body.gap(b)[0]) <= dist(a, b) + 1e-9


@given(positions)
@pytest.mark.parametrize("body", [MAST, HOUSE], ids=["cylinder", "box"])
def test_the_gap_leads_to_the_surface(body: Obstacle, position: Vector3) -> None:
    distance_m, normal = body.gap(position)
    assert hypot(*normal) == pytest.approx(1.0)
    foot = tuple(p - distance_m * n for p, n in zip(position, normal, strict=True))
    assert body.gap((foot[0], foot[1], foot[2]))[0] == pytest.approx(0.0, abs=1e-6)


def test_inside_an_obstacle_the_nearest_way_out_counts() -> None:
    assert MAST.gap((5.5, -3.0, 4.0)) == (-1.5, (1.0, 0.0, 0.0))
    assert MAST.gap((5.5, -3.0, 7.5)) == (-0.5, (0.0, 0.0, 1.0))
    assert HOUSE.gap((0.0, 5.0, 4.0)) == (-1.0, (0.0, 0.0, 1.0))
    assert HOUSE.gap((-3.5, 5.0, 2.0)) == (-0.5, (-1.0, 0.0, 0.0))


@given(positions)
def test_polygon_walls_agree_with_the_fence(position: Vector3) -> None:
    nearest_m = min(distance_m for distance_m, _ in FENCE.gaps(position))
    if abs(nearest_m) > 1e-6:
        assert (nearest_m > 0.0) is FENCE.contains(position)


def test_a_concave_polygon_has_room_beside_its_notch() -> None:
    airspace = Airspace(FENCE, clearance_m=0.5)
    assert FENCE.contains((5.0, 18.0, 3.0))
    assert airspace.room_m((5.0, 18.0, 3.0)) == pytest.approx(1.5)
    assert not FENCE.contains((15.0, 15.0, 3.0))
    assert not FENCE.contains((float("nan"), 5.0, 3.0))
    assert airspace.room_m((15.0, 12.0, 3.0)) == pytest.approx(-2.5)  # the way back is south
    assert min(FENCE.gaps((15.0, 12.0, 3.0)))[1] == pytest.approx((0.0, -1.0, 0.0))
    assert area_m2(U_SHAPE) == 500.0


def test_crossing_sides_are_found() -> None:
    assert crossing_sides(U_SHAPE) is None
    assert crossing_sides(((0.0, 0.0), (4.0, 4.0), (4.0, 0.0), (0.0, 4.0))) == (0, 2)
    assert crossing_sides(((0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (2.0, 0.0))) is not None  # a corner on a side
    assert in_polygon((1.0, 1.0), U_SHAPE)


def test_a_leg_through_a_thin_obstacle_is_found() -> None:
    pole = Airspace(Fence((-50.0, -50.0, 0.0), (50.0, 50.0, 20.0)), (Cylinder((0.0, 0.0), 0.1, -100.0, 100.0),), 0.5)
    conflict = whole(leg_conflict_steps(pole, (-40.0, 0.3, 5.0), (40.0, 0.3, 5.0)))
    assert conflict is not None and hypot(*conflict[:2]) <= 0.6
    assert whole(leg_conflict_steps(pole, (-40.0, 0.61, 5.0), (40.0, 0.61, 5.0))) is None
    assert whole(leg_conflict_steps(pole, (-40.0, 1.5, 5.0), (40.0, 1.5, 5.0), around_m=1.0)) is not None
    assert whole(leg_conflict_steps(pole, (0.0, 0.2, 5.0), (0.0, 0.2, 5.0))) is not None


def test_a_curved_path_is_checked_along_its_whole_length() -> None:
    airspace = Airspace(FENCE, (), 0.5)

    def around_the_notch(angle: float) -> Vector3:
        return (15.0 + 8.0 * cos(angle), 10.0 + 8.0 * sin(angle), 3.0)

    below_the_notch = conflict_steps(airspace, lambda s: around_the_notch(pi + s), pi, 8.0)
    assert whole(below_the_notch) is None
    assert whole(conflict_steps(airspace, around_the_notch, pi, 8.0)) is not None  # through it
