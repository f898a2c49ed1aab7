from itertools import combinations, product
from math import cos, dist, hypot, isfinite, pi, radians, sin, tan
from random import Random

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from msgspec.structs import replace
from scipy.optimize import linprog

from common import count_calls
from companion.core.filter.solver import AccelerationLimits, Constraint, Rank, filter_acceleration, shortfalls
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

LIMITS = AccelerationLimits.of_envelope(tan(radians(25.0)), 0.3, 1.6)
LEVEL_M_S2 = LIMITS.level_radius_m_s2(0.0)
EAST, WEST, NORTH = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def unit(azimuth_rad: float, up: float) -> Vector3:
    level = (1.0 - up * up) ** 0.5
    return (level * cos(azimuth_rad), level * sin(azimuth_rad), up)


def to_constraint(normal_enu: Vector3, least_m_s2: float, rank: Rank = Rank.VEHICLE) -> Constraint:
    return (*normal_enu, least_m_s2, rank)


def direction(x: float, y: float, z: float) -> Vector3:
    size = hypot(x, y, z)
    return (x / size, y / size, z / size)


angles = st.floats(-3.1, 3.1)
normals = st.builds(unit, angles, st.floats(-0.7, 0.7))
ranks = st.sampled_from([Rank.VEHICLE, Rank.OBSTACLE, Rank.FENCE])
spaces = st.builds(to_constraint, normals, st.floats(-8.0, 8.0), ranks)
wanted = st.tuples(*[st.floats(-6.0, 6.0)] * 3)


def along(normal: Vector3, u: Vector3) -> float:
    return sum(n * x for n, x in zip(normal, u, strict=True))


def test_the_same_object_returns_where_nothing_is_violated() -> None:
    u = (9.0, 1.0, 0.5)  # beyond the limits: those of the output come later
    assert filter_acceleration(u, [to_constraint(EAST, 4.0), to_constraint(NORTH, -1.0)], LIMITS) is u
    assert filter_acceleration(u, [], LIMITS) is u


def test_more_than_the_vehicle_can_fly_meets_a_half_space_by_what_is_left_within_the_limits() -> None:
    """Of (3, 30) m/s^2 the tilt limit leaves 0.5 to the east."""
    x, y, z = filter_acceleration((3.0, 30.0, 0.0), [to_constraint(EAST, 2.5)], LIMITS)
    assert x == pytest.approx(2.5, abs=0.01)
    assert hypot(x, y) == pytest.approx(LEVEL_M_S2, rel=0.02)
    assert (y > 0.0, z) == (True, pytest.approx(0.0, abs=0.01))


def test_no_fall_is_faster_than_the_least_thrust_allows() -> None:
    x, y, z = filter_acceleration((0.0, 0.0, -9.0), [to_constraint(EAST, 0.5)], LIMITS)
    assert (x, y) == (pytest.approx(0.5, abs=0.01), pytest.approx(0.0, abs=0.01))
    assert z == pytest.approx(LIMITS.lowest_m_s2, abs=0.01)


def test_one_half_space_changes_only_the_component_along_its_normal() -> None:
    assert filter_acceleration((-2.0, 1.0, 0.5), [to_constraint(EAST, 1.0)], LIMITS) == pytest.approx((1.0, 1.0, 0.5))


def test_a_corner_of_two_half_spaces_is_met() -> None:
    assert filter_acceleration(
        (-1.0, -1.0, 0.0), [to_constraint(EAST, 1.0), to_constraint(NORTH, 2.0)], LIMITS
    ) == pytest.approx((1, 2, 0))


def test_a_half_space_that_others_make_unnecessary_is_left_again() -> None:
    """The one that is violated most comes first; in the end the two others alone decide."""
    wests, ups, first = to_constraint(WEST, 1.9), to_constraint(direction(3, 4, 2), 1.9), direction(-4, 3, -1)
    u = filter_acceleration((0.0, 0.0, 0.0), [wests, ups, to_constraint(first, 2.4)], LIMITS)
    assert (along(WEST, u), along(direction(3, 4, 2), u)) == pytest.approx((1.9, 1.9))
    assert along(first, u) == pytest.approx(3.05, abs=0.01)


def test_full_authority_where_more_is_asked_than_the_tilt_allows() -> None:
    x, y, _ = filter_acceleration((0.0, 0.0, 0.0), [to_constraint(EAST, 50.0)], LIMITS)
    assert (x, y) == pytest.approx((LEVEL_M_S2, 0.0))


def test_wind_moves_the_limits() -> None:
    windy = replace(LIMITS, disturbance_enu_m_s2=(1.5, 0.0, 0.0))
    assert filter_acceleration((0.0, 0.0, 0.0), [to_constraint(EAST, 50.0)], windy)[0] == pytest.approx(
        LEVEL_M_S2 + 1.5
    )
    assert filter_acceleration((0.0, 0.0, 0.0), [to_constraint(WEST, 50.0)], windy)[0] == pytest.approx(
        1.5 - LEVEL_M_S2
    )


def test_two_vehicles_that_contradict_each_other_are_violated_alike() -> None:
    assert filter_acceleration((0.5, 0.0, 0.0), [to_constraint(EAST, 3.0), to_constraint(WEST, 1.0)], LIMITS)[
        0
    ] == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("rank", [Rank.OBSTACLE, Rank.FENCE])
def test_a_vehicle_comes_before_obstacle_and_fence(rank: Rank) -> None:
    spaces = [to_constraint(WEST, 1.0, rank), to_constraint(EAST, 3.0, Rank.VEHICLE)]
    assert filter_acceleration((0.0, 0.0, 0.0), spaces, LIMITS)[0] == pytest.approx(3.0, abs=1e-3)


# Where two walls of the fence and its top meet: a slow vehicle that flies into the corner, and a fast one.
CORNERS = [
    [((-1.0, 0.0, 0.0), 2.7), ((0.0, -1.0, 0.0), 2.7), ((0.0, 0.0, -1.0), 2.6)],
    [((1.0, 0.0, 0.0), 20.6), ((0.0, -1.0, 0.0), 26.4), ((0.0, 0.0, -1.0), 5.6)],
]


@pytest.mark.parametrize("most_steps", range(3, 13))
@pytest.mark.parametrize("corner", CORNERS)
def test_no_half_space_is_left_out_where_the_steps_do_not_suffice(
    corner: list[tuple[Vector3, float]], most_steps: int
) -> None:
    asked = [to_constraint(normal, least, Rank.FENCE) for normal, least in corner]
    u = filter_acceleration((-0.6, 1.8, 2.0), asked, LIMITS, most_steps)
    for normal, least in corner:
        assert along(normal, u) > min(0.8 * least, 1.2)


def test_where_the_steps_do_not_suffice_vehicles_come_first() -> None:
    """Three vehicles that can be kept off, and a fence and a speed limit that ask for the opposite."""
    vehicles = [
        to_constraint((-0.172, -0.976, -0.137), 4.3),
        to_constraint((0.093, -0.978, -0.187), -4.3),
        to_constraint((0.521, -0.844, -0.125), 5.6),
    ]
    others = [
        to_constraint((-0.379, 0.889, 0.255), 4.4, Rank.FENCE),
        to_constraint((0.912, 0.371, 0.174), 1.1, Rank.FENCE),
        to_constraint((-0.157, 0.708, -0.688), 0.9, Rank.SPEED),
        to_constraint((0.553, 0.741, -0.381), -4.3, Rank.SPEED),
        to_constraint((-0.321, 0.704, -0.633), -2.7, Rank.SPEED),
    ]
    asked = [others[0], others[2], others[1], others[3], *vehicles, others[4]]
    u = filter_acceleration((0.78, -4.01, 1.86), asked, LIMITS)
    assert all(along(space[:3], u) > space[3] - 0.05 for space in vehicles)


def test_an_obstacle_comes_before_the_fence() -> None:
    spaces = [to_constraint(WEST, 1.0, Rank.FENCE), to_constraint(EAST, 3.0, Rank.OBSTACLE)]
    assert filter_acceleration((0.0, 0.0, 0.0), spaces, LIMITS)[0] == pytest.approx(3.0, abs=1e-3)


@settings(max_examples=200, deadline=None, phases=(Phase.generate,))
@given(wanted, st.lists(spaces, max_size=9))
def test_the_result_is_finite_and_possible_whatever_is_asked(u: Vector3, asked: list[Constraint]) -> None:
    x, y, z = found = filter_acceleration(u, asked, LIMITS)
    assert all(isfinite(c) for c in found)
    if found is not u:
        assert hypot(x, y) <= LIMITS.level_radius_m_s2(z) * 1.0001
        assert LIMITS.lowest_m_s2 - 1e-6 <= z <= LIMITS.highest_m_s2 + 1e-6


@settings(max_examples=60, deadline=None, phases=(Phase.generate,))
@given(
    st.tuples(*[st.floats(-2.0, 2.0)] * 3),
    st.lists(st.builds(to_constraint, normals, st.floats(-2.0, 1.0)), min_size=1, max_size=6),
)
def test_no_point_of_a_grid_is_nearer_and_allowed(u: Vector3, asked: list[Constraint]) -> None:
    found = filter_acceleration(u, asked, LIMITS)
    steps = [0.4 * k for k in range(-8, 9)]
    for point in product(steps, steps, steps):
        if hypot(point[0], point[1]) <= LIMITS.level_radius_m_s2(point[2]) and all(
            along(space[:3], point) >= space[3] for space in asked
        ):
            assert dist(found, u) <= dist(point, u) + 1e-6
            assert all(along(space[:3], found) >= space[3] - 0.05 for space in asked)


# ---------------------------------------------------------------- against all active sets, and the limits to the number

FREE = AccelerationLimits(1e3, -9.0, 1e3, (0.0, 0.0, 0.0))  # nothing that is asked below reaches a limit


def nearest_of_all_active_sets(u: Vector3, asked: list[Constraint]) -> np.ndarray | None:
    """The nearest point that meets all constraints, by solving each set of up to three of them with equality."""
    best, start = None, np.array(u)
    for count in range(4):
        for active in combinations(asked, count):
            point = start
            if active:
                normals, least = np.array([c[:3] for c in active]), np.array([c[3] for c in active])
                gram = normals @ normals.T
                if np.linalg.cond(gram) > 1e6:
                    continue
                point = start + normals.T @ np.linalg.solve(gram, least - normals @ start)
            if all(np.dot(c[:3], point) >= c[3] - 1e-9 for c in asked):
                apart = np.linalg.norm(point - start)
                if best is None or apart < np.linalg.norm(best - start):
                    best = point
    return best


@pytest.mark.parametrize("count", range(1, 8))
def test_the_result_is_that_of_the_best_active_set(count: int) -> None:
    random, solved = Random(count), 0
    for _ in range(25):
        asked = [
            to_constraint(unit(random.uniform(-3.1, 3.1), random.uniform(-0.9, 0.9)), random.uniform(-2.0, 1.5))
            for _ in range(count)
        ]
        u = (random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0), random.uniform(-3.0, 3.0))
        expected = nearest_of_all_active_sets(u, asked)
        if expected is not None and abs(expected).max() < 8.0:
            solved += 1
            assert filter_acceleration(u, asked, FREE, 60) == pytest.approx(expected, abs=1e-4)
    assert solved > 5


@pytest.mark.parametrize("seed", range(4))
def test_what_cannot_be_met_is_missed_by_the_least_amount_that_is_possible(seed: int) -> None:
    """The same for all of one rank: against a linear program."""
    random, contradicted = Random(seed), 0
    for _ in range(40):
        asked = [
            to_constraint(unit(random.uniform(-3.1, 3.1), random.uniform(-0.9, 0.9)), random.uniform(0.0, 3.0))
            for _ in range(4)
        ]
        normals, least = np.array([c[:3] for c in asked]), np.array([c[3] for c in asked])
        columns = np.hstack([-normals, -np.ones((len(asked), 1))])
        found = linprog([0, 0, 0, 1], columns, -least, bounds=[(-50, 50), (-50, 50), (-9, 50), (0, None)])
        u = filter_acceleration((random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), 0.5), asked, FREE, 200)
        if np.abs(u).max() < 40.0:
            contradicted += found.x[3] > 0.01
            assert max(*(least - normals @ np.array(u)), 0.0) == pytest.approx(found.x[3], abs=1e-3)
    assert contradicted > 2


@pytest.mark.parametrize("seed", range(3))
def test_the_vertical_limits_are_planes_like_the_constraints(seed: int) -> None:
    low, random, bound = replace(FREE, lowest_m_s2=-0.5, highest_m_s2=0.8), Random(seed), 0
    planes = [to_constraint((0.0, 0.0, -1.0), -0.8), to_constraint((0.0, 0.0, 1.0), -0.5)]
    for _ in range(40):
        asked = [
            to_constraint(unit(random.uniform(-3.1, 3.1), random.uniform(-0.8, 0.8)), random.uniform(-1.0, 1.5))
            for _ in range(3)
        ]
        u = (random.uniform(-2.0, 2.0), random.uniform(-2.0, 2.0), random.uniform(-0.5, 0.8))
        expected = nearest_of_all_active_sets(u, [*asked, *planes])
        if expected is not None and abs(expected).max() < 8.0:
            bound += expected[2] in (-0.5, 0.8)
            assert filter_acceleration(u, asked, low, 60) == pytest.approx(expected, abs=1e-3)


@pytest.mark.parametrize("wind", [(0.0, 0.0, 0.0), (0.7, -0.4, 0.0), (-0.5, 0.9, 0.0)])
@pytest.mark.parametrize("turn_rad", [0.0, 1.1, -2.0])
@pytest.mark.parametrize("up_m_s2", [1.0, -3.0])
def test_beside_a_constraint_what_the_tilt_leaves_is_used(up_m_s2: float, turn_rad: float, wind: Vector3) -> None:
    """The nearest point on plane and cone, by trying heights: beside a climb at its height, in a dive with more thrust."""
    across, towards = (-sin(turn_rad), cos(turn_rad)), (cos(turn_rad), sin(turn_rad))
    windy, tilt = replace(LIMITS, disturbance_enu_m_s2=wind), tan(radians(25.0))
    gone = wind[0] * towards[0] + wind[1] * towards[1]
    aside = wind[0] * across[0] + wind[1] * across[1]
    least = 0.9 * (up_m_s2 + GRAVITY_M_S2) * tilt
    wish = 0.7 * (up_m_s2 + GRAVITY_M_S2) * tilt
    start = (
        aside * across[0] + wish * across[0] + gone * towards[0],
        aside * across[1] + wish * across[1] + gone * towards[1],
    )
    constraint = to_constraint((*towards, 0.0), least + gone)
    x, y, z = filter_acceleration((*start, up_m_s2), [constraint], windy, 60)
    heights = [up_m_s2] if up_m_s2 > 0.0 else [up_m_s2 + 0.01 * k for k in range(300)]
    radii = [((h + GRAVITY_M_S2) * tilt, h) for h in heights]
    options = [
        (hypot(wish - min(wish, (r * r - least * least) ** 0.5), h - up_m_s2), r, h) for r, h in radii if r > least
    ]
    _, radius, height = min(options)
    assert z == pytest.approx(height, abs=0.1)
    assert x * towards[0] + y * towards[1] == pytest.approx(least + gone, abs=0.06)
    expected_across = aside + min(wish, (radius * radius - least * least) ** 0.5)
    assert x * across[0] + y * across[1] == pytest.approx(expected_across, abs=0.25)


@pytest.mark.parametrize("most_steps", range(6))
def test_each_step_of_the_method_meets_one_constraint_more(most_steps: int) -> None:
    """Of four at right angles or opposite to each other, the one that is violated most first."""
    asked = [
        to_constraint(EAST, 2.0),
        to_constraint(NORTH, 3.0),
        to_constraint((0.0, 0.0, 1.0), 1.0),
        to_constraint(direction(1, 1, 1), 3.6),
    ]
    u = filter_acceleration((0.0, 0.0, 0.0), asked, FREE, most_steps)
    met = [along(space[:3], u) >= space[3] - 1e-5 for space in asked]
    assert met[3] is (most_steps > 0)
    assert met[1] is (most_steps > 1)
    assert all(met) is (most_steps > 2)


@pytest.mark.parametrize("ranks", [(Rank.GROUND, Rank.FENCE), (Rank.VEHICLE, Rank.MARGIN), (Rank.SPEED, Rank.UNSHAKEN)])
@pytest.mark.parametrize("angle", [0.0, 0.7, 2.0])
def test_of_a_contradiction_the_lower_rank_gives_way_by_no_more_than_it_must(
    ranks: tuple[Rank, Rank], angle: float
) -> None:
    """Three planes that leave no point between them: two of the lower rank give way alike."""
    normals = [unit(angle + turn, 0.0) for turn in (0.0, 2.0 * pi / 3.0, -2.0 * pi / 3.0)]
    asked = [
        to_constraint(n, least, rank)
        for n, least, rank in zip(normals, (1.0, 1.0, 0.4), (*ranks, ranks[1]), strict=True)
    ]
    u = filter_acceleration((0.1, -0.2, 0.0), asked, FREE, 60)
    short = [space[3] - along(space[:3], u) for space in asked]
    assert short == pytest.approx([0.0, 1.2, 1.2], abs=1e-4)


ORDER = ("GROUND", "VEHICLE", "OBSTACLE", "FENCE", "MARGIN", "SPEED", "UNSHAKEN")


@pytest.mark.parametrize(("first", "second"), list(combinations(ORDER, 2)))
def test_the_ranks_give_way_in_this_order(first: str, second: str) -> None:
    asked = [to_constraint(WEST, 1.0, Rank[second]), to_constraint(EAST, 3.0, Rank[first])]
    assert filter_acceleration((0.0, 0.0, 0.0), asked, LIMITS)[0] == pytest.approx(3.0, abs=1e-3)
    assert [rank.name for rank in Rank] == ["LIMIT", *ORDER]


@pytest.mark.parametrize("name", ORDER)
def test_what_can_be_flown_comes_before_all(name: str) -> None:
    u = filter_acceleration(ZERO3, [to_constraint((0.0, 0.0, 1.0), 30.0, Rank[name])], LIMITS)
    assert u[2] == pytest.approx(LIMITS.highest_m_s2, abs=1e-3)


def test_shortfalls_are_the_worst_of_each_rank() -> None:
    rows = [
        to_constraint(EAST, 3.0, Rank.FENCE),
        to_constraint(NORTH, 3.5, Rank.FENCE),
        to_constraint((0.0, 0.6, 0.8), 1.0, Rank.VEHICLE),
        to_constraint(WEST, -9.0, Rank.SPEED),
        to_constraint(EAST, 1.1, Rank.LIMIT),
        to_constraint(EAST, 1.2, Rank.UNSHAKEN),
    ]
    found = shortfalls((1.0, 2.0, -1.0), rows)
    assert found == pytest.approx([0.1, 1e-6, 0.6, 1e-6, 2.0, 1e-6, 1e-6, 0.2])


def test_the_limits_are_a_cut_cone_about_the_wind() -> None:
    """The vertical part is limited first, then the direction over ground is kept."""
    g = GRAVITY_M_S2
    assert (LIMITS.lowest_m_s2, LIMITS.highest_m_s2) == pytest.approx((-0.7 * g, 0.6 * g))
    tilt = tan(radians(25.0))
    radii = [LIMITS.level_radius_m_s2(up) for up in (0.0, 2.0, 99.0, -99.0)]
    assert radii == pytest.approx([g * tilt, (g + 2.0) * tilt, 1.6 * g * tilt, 0.3 * g * tilt])
    windy = replace(LIMITS, disturbance_enu_m_s2=(1.5, -0.5, 0.0))
    assert windy.limit((1.5 + 6.0, -0.5 - 8.0, 1.0)) == pytest.approx(
        (1.5 + 0.6 * (g + 1.0) * tilt, -0.5 - 0.8 * (g + 1.0) * tilt, 1.0)
    )
    assert windy.limit((1.0, 1.0, 99.0)) == pytest.approx((1.0, 1.0, 0.6 * g))
    assert windy.limit((1.5, -0.5, -99.0)) == pytest.approx((1.5, -0.5, -0.7 * g))
    for possible in ((1.0, 1.0, 0.5), (1.5 + 0.999 * g * tilt, -0.5, 0.0), (1.5, -0.5, 0.6 * g)):
        assert windy.limit(possible) is possible


@pytest.mark.parametrize("normal", [EAST, direction(1, 2, 1), direction(-1, 0.2, 0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)])
def test_more_than_can_be_flown_is_asked_as_all_of_it(normal: Vector3) -> None:
    """So two that ask for far too much share what there is, whatever they ask for."""
    windy = replace(LIMITS, disturbance_enu_m_s2=(0.7, -0.4, 0.0))
    found = [filter_acceleration(ZERO3, [to_constraint(normal, least)], windy) for least in (30.0, 3000.0)]
    assert found[0] == pytest.approx(found[1])
    (nx, ny, nz), (x, y, z) = normal, found[0]
    level_m_s2 = hypot(nx, ny) * LEVEL_M_S2 + nx * 0.7 - ny * 0.4
    assert along(normal, found[0]) > 0.75 * level_m_s2 + 0.75 * abs(nz) * 5.0
    assert hypot(x - 0.7, y + 0.4) <= windy.level_radius_m_s2(z) * 1.0001


@pytest.mark.parametrize("azimuth", [0.3, 2.5])
def test_a_level_constraint_changes_no_height(azimuth: float) -> None:
    found = filter_acceleration((0.0, 0.0, 2.0), [to_constraint(unit(azimuth, 0.0), 9.0)], LIMITS, 20)
    assert found[2] == pytest.approx(2.0, abs=0.01)
    assert along(unit(azimuth, 0.0), found) == pytest.approx(LIMITS.level_radius_m_s2(2.0), rel=0.02)


def test_a_constraint_that_no_vehicle_violates_is_left_out_and_a_met_one_is_met_within_rounding() -> None:
    u = (-13.0, 0.0, 0.0)
    assert filter_acceleration(u, [to_constraint(EAST, -13.0 + 0.5e-6)], FREE) is u
    assert filter_acceleration(u, [to_constraint(EAST, -13.0 + 2e-6)], FREE) is not u
    both = [to_constraint(EAST, -12.5), to_constraint(NORTH, 1.0)]
    assert filter_acceleration(u, both, FREE) == pytest.approx((-13.0, 1.0, 0.0))  # below -12: never active
    both = [to_constraint(EAST, -11.5), to_constraint(NORTH, 1.0)]
    assert filter_acceleration(u, both, FREE) == pytest.approx((-11.5, 1.0, 0.0))


# ---------------------------------------------------------------- steps, and what the limits leave of a corner


def test_of_half_a_solution_and_the_wish_that_counts_which_misses_the_higher_rank_by_less() -> None:
    """Two steps end in the contradiction: by then the fence, which asks for more, has led 3 m/s^2 towards the vehicle."""
    asked = [to_constraint(EAST, 3.0, Rank.FENCE), to_constraint(WEST, 1.0, Rank.VEHICLE)]
    assert filter_acceleration(ZERO3, asked, LIMITS, 2) == ZERO3
    assert filter_acceleration(ZERO3, asked, LIMITS, 3)[0] == pytest.approx(-1.0, abs=1e-3)


def test_a_step_in_which_a_constraint_leaves_counts_as_well() -> None:
    asked = [
        to_constraint(WEST, 1.9),
        to_constraint(direction(3, 4, 2), 1.9),
        to_constraint(direction(-4, 3, -1), 2.4),
    ]
    reached = [filter_acceleration(ZERO3, asked, LIMITS, steps) for steps in (3, 4, 60)]
    short = [max(space[3] - along(space[:3], u) for space in asked) for u in reached]
    assert short[0] > 0.1
    assert max(short[1:]) < 1e-5


def test_a_constraint_that_comes_in_two_steps_leaves_no_sooner_than_it_must() -> None:
    """Its multiplier is that of both steps."""
    rows = (((0, 1, 3), 1.0), ((-2, -2, 3), -0.5), ((-1, 2, 3), 1.0), ((2, 0, 2), 1.0), ((-2, -2, 2), 1.0))
    asked = [to_constraint(direction(*normal), least) for normal, least in rows]
    expected = nearest_of_all_active_sets(ZERO3, asked)
    assert expected is not None
    assert filter_acceleration(ZERO3, asked, FREE, 60) == pytest.approx(expected, abs=1e-4)


def test_what_is_at_right_angles_to_a_contradiction_keeps_what_it_asks() -> None:
    asked = [to_constraint(NORTH, 3.5, Rank.FENCE), to_constraint(EAST, 3.0), to_constraint(WEST, 1.0)]
    assert filter_acceleration(ZERO3, asked, LIMITS, 20) == pytest.approx((1.0, 3.5, 0.0), abs=1e-3)


@pytest.mark.parametrize(
    ("start", "asked", "within_m_s2"),
    [
        ((0.0, 5.9, 3.0), [to_constraint(direction(3, 0, 4), 8.0)], 0.02),
        ((0.0, 1.2, -6.0), [to_constraint(direction(3, 0, -4), 6.2)], 1e-3),
        ((0.0, 2.8, -3.0), [to_constraint(EAST, 2.6), to_constraint((0.0, 0.0, -1.0), 2.95)], 1e-3),
        ((0.0, 2.8, -3.0), [to_constraint(EAST, 2.6), to_constraint(direction(3, 0, -4), 3.9)], 1e-3),
    ],
    ids=["beside the highest", "beside the lowest", "in a dive", "in a steeper dive"],
)
def test_in_a_corner_of_limits_and_constraints_the_wish_across_gives_way(
    start: Vector3, asked: list[Constraint], within_m_s2: float
) -> None:
    """All that tilt and thrust allow is needed for what is asked: only the acceleration to the north can be less."""
    u = filter_acceleration(start, asked, LIMITS, 20)
    assert all(along(space[:3], u) == pytest.approx(space[3], abs=within_m_s2) for space in asked)
    assert hypot(u[0], u[1]) == pytest.approx(LIMITS.level_radius_m_s2(u[2]), rel=1e-6)
    assert LIMITS.lowest_m_s2 <= u[2] <= LIMITS.highest_m_s2
    assert 0.0 < u[1] < start[1]


def test_an_excess_of_tilt_by_less_than_a_hundredth_takes_no_further_step() -> None:
    """The output limits take it off."""
    calls = []
    for east_m_s2 in (0.10, 0.18, 0.27):  # with 0.99 to the north 0.995, 1.006 and 1.026 of what the tilt allows
        asked = [to_constraint(EAST, east_m_s2 * LEVEL_M_S2)]
        with count_calls() as work:
            filter_acceleration((0.0, 0.99 * LEVEL_M_S2, 0.0), asked, LIMITS, 60)
        calls.append(work.calls)
    assert calls[1] < calls[0] + 6
    assert calls[2] > calls[0] + 10


def test_a_contradiction_is_solved_by_relaxing_it_once() -> None:
    """The relaxed constraints are met together, in spite of rounding."""
    calls = []
    for asked in ([to_constraint(EAST, 3.0)], [to_constraint(EAST, 3.0), to_constraint(WEST, 1.0)]):
        with count_calls() as work:
            filter_acceleration(ZERO3, asked, LIMITS, 60)
        calls.append(work.calls)
    assert calls[1] < 3 * calls[0]


def test_five_steps_are_taken_where_no_number_is_given() -> None:
    """It bounds the time of a tick."""
    asked = [to_constraint(unit(1.2 * k, 0.3 * (-1) ** k), 2.0 + 0.2 * k, Rank(1 + k % 5)) for k in range(7)]
    reached = [filter_acceleration(ZERO3, asked, LIMITS, steps) for steps in (4, 5, 6)]
    assert reached[0] != pytest.approx(reached[1])
    assert reached[2] != pytest.approx(reached[1])
    assert filter_acceleration(ZERO3, asked, LIMITS) == reached[1]


@pytest.mark.parametrize(("asked_m_s2", "shared_m_s2"), [(1.9, 1.1), (0.95, 0.95)])
def test_from_one_metre_per_second_squared_on_only_what_the_wind_leaves_is_asked(
    asked_m_s2: float, shared_m_s2: float
) -> None:
    """Two vehicles on both sides; the wind leaves 1.1 to the east, or 0.4, where the smaller wish counts in whole."""
    windy = replace(LIMITS, disturbance_enu_m_s2=(min(shared_m_s2, asked_m_s2 - 0.55) - LEVEL_M_S2, 0.0, 0.0))
    asked = [to_constraint(EAST, asked_m_s2), to_constraint(WEST, 0.9)]
    assert filter_acceleration((-0.2, 0.0, 0.0), asked, windy, 20)[0] == pytest.approx(
        0.5 * (shared_m_s2 - 0.9), abs=1e-3
    )
