"""The constraint of one other vehicle to the number: the barrier condition, the distance that is kept, and who gives way."""

from __future__ import annotations

from itertools import permutations
from math import hypot, inf, sqrt

import pytest
from msgspec.structs import replace

from companion.core.filter.motion import Ahead, Motion, Other, Silence, nearest_on_way
from companion.core.filter.solver import Rank
from companion.core.filter.vehicles import (
    KEPT_M,
    Barrier,
    Separation,
    SeparationSettings,
    eased,
    largest_removed_m_s2,
    nearest_and_violated,
    turn_right,
)
from companion.geometry.curves import approach_speed
from companion.types.autopilot import PositionError, VehicleState
from companion.types.formation import FlownSlot, Gains
from companion.types.values import ZERO3, Vector3

SEPARATION_M, BRAKING_M_S2 = 2.0, 1.5  # the distance that is kept: separation_m and some millimetres
SETTINGS = SeparationSettings(1, SEPARATION_M - KEPT_M, BRAKING_M_S2, 0.3, 8.0)
LAG_S = 0.2
NO_ERROR = PositionError(0.0, 0.0)
ALONE_M = 0.15  # ripple and tracking, where the other makes no way
STEP_S = 1e-5


def other(
    position_enu_m: Vector3,
    velocity_enu_m_s: Vector3 = ZERO3,
    acceleration_enu_m_s2: Vector3 = ZERO3,
    **changes: object,
) -> Other:
    """A vehicle that does not cooperate and was heard just now."""
    known = Other(
        key=2,
        last=(position_enu_m, velocity_enu_m_s, acceleration_enu_m_s2),
        commanded_enu_m_s2=acceleration_enu_m_s2,
        age_s=0.0,
        silence=None,
        error=NO_ERROR,
        height_weight=1.0,
        slot=None,
        makes_way=False,
        side=1.0,
    )
    return replace(known, **changes)


def barrier(ahead: Ahead, one: Other, slot: FlownSlot | None = None, error: PositionError = NO_ERROR) -> Barrier:
    return Separation(SETTINGS).barrier(ahead, error, slot, one)


def required_m(one: Other, slot: FlownSlot | None = None, error: PositionError = NO_ERROR) -> float:
    """Of a vehicle at rest at the origin."""
    return barrier(Ahead(ZERO3, ZERO3), one, slot, error).required_m


# ---------------------------------------------------------------- the barrier condition


def value(own: Ahead, one: Other, needed_m: float, braking_m_s2: float) -> tuple[float, Vector3, float]:
    """h = d' + V(d - D) in the metric of the separation, the gradient of d, and how fast the line turns: (v^2 - d'^2)/d.

    Both vehicles are ahead by lag and age.
    """
    ahead_s = one.age_s + LAG_S
    (p, v, a), w = one.last, one.height_weight
    apart = [o - q - s * ahead_s for o, q, s in zip(own.position_enu_m, p, v, strict=True)]
    moves = [o - s - b * ahead_s for o, s, b in zip(own.velocity_enu_m_s, v, a, strict=True)]
    x, y, z = apart[0], apart[1], w * apart[2]
    distance_m = hypot(x, y, z)
    rate_m_s = (x * moves[0] + y * moves[1] + z * w * moves[2]) / distance_m
    turns_m2_s2 = moves[0] ** 2 + moves[1] ** 2 + (w * moves[2]) ** 2 - rate_m_s**2
    gradient = (x / distance_m, y / distance_m, w * z / distance_m)
    allowed_m_s, _ = approach_speed(distance_m - needed_m, braking_m_s2, 4.0, 1.5)
    return rate_m_s + allowed_m_s, gradient, turns_m2_s2 / distance_m - turns_m2_s2 / (distance_m + 0.1)


STATES = [
    (Ahead((5.0, 1.0, 0.5), (-1.0, 0.4, 0.1)), other((0.0, 0.0, 0.0), (0.5, -0.3, 0.2), (0.4, 0.2, -0.1))),
    (Ahead((-3.0, 2.0, -1.0), (0.6, -0.8, 0.3)), other((0.2, 0.1, 0.4), (-0.4, 0.2, 0.0), age_s=0.08)),
    (Ahead((1.8, -1.0, 0.4), (0.1, 0.3, -0.2)), other((0.0, 0.0, 0.0), (0.2, 0.1, 0.1), height_weight=0.5)),
    (
        Ahead((0.5, -1.0, 6.0), (0.1, 0.3, -0.8)),
        other((0.0, 0.0, 0.0), (0.0, 0.1, 0.9), height_weight=0.5, makes_way=True),
    ),
    (Ahead((2.0, 3.0, 6.0), (-0.3, -0.3, 0.8)), other((0.0, 0.0, 0.0), (0.6, 0.1, -0.9), height_weight=0.0)),
    (
        Ahead((0.6, 0.7, 0.9), (-0.1, 0.3, 0.2)),
        other((0.0, 0.0, 0.0), (0.1, 0.2, -0.3), (0.2, -0.1, 0.3), height_weight=0.5),
    ),
]


@pytest.mark.parametrize(("own", "one"), STATES)
def test_on_the_constraint_the_barrier_falls_by_its_response(own: Ahead, one: Other) -> None:
    """h' = -5 h, of a vehicle that flies on the plane, while the other flies as it was commanded.

    The turn of the line is that at a distance of 0.1 m more, and so stays finite.
    """
    found = barrier(own, one)
    nx, ny, nz, least, rank = found.constraint
    _, gradient, finite_m_s2 = value(own, one, found.required_m, 1.0)
    size = hypot(*gradient)
    braking_m_s2 = 0.6 * BRAKING_M_S2 * size
    before, *_ = value(own, one, found.required_m, braking_m_s2)
    assert (nx, ny, nz) == pytest.approx(tuple(part / size for part in gradient))
    assert rank is Rank.VEHICLE and found.constraint_without_margins is None
    assert found.other is one
    ahead_s = one.age_s + LAG_S
    assert found.offset_enu_m == pytest.approx(
        tuple(o - q - v * ahead_s for o, q, v in zip(own.position_enu_m, *one.last[:2], strict=True))
    )
    flown = tuple(least * n for n in (nx, ny, nz))
    later = Ahead(
        tuple(p + STEP_S * v for p, v in zip(own.position_enu_m, own.velocity_enu_m_s, strict=True)),
        tuple(v + STEP_S * u for v, u in zip(own.velocity_enu_m_s, flown, strict=True)),
    )
    # In its coordinates ahead the other is at p + v t and flies by v + a t: both grow with the time.
    (p, v, a), ahead_s = one.last, one.age_s + LAG_S
    moves = tuple(s + b * ahead_s for s, b in zip(v, a, strict=True))
    there = tuple(q + STEP_S * m + ahead_s * s for q, m, s in zip(p, moves, v, strict=True))
    turns = tuple(m + STEP_S * b for m, b in zip(moves, a, strict=True))
    moved = replace(one, last=(there, turns, ZERO3), age_s=-LAG_S)
    after, *_ = value(later, moved, found.required_m, braking_m_s2)
    assert (after - before) / STEP_S == pytest.approx(-5.0 * before + finite_m_s2, abs=2e-4)


def test_of_two_that_cooperate_each_takes_half_or_what_the_other_leaves_open() -> None:
    own, slot, its_slot = Ahead((4.0, 0.0, 0.0), (-1.5, 0.0, 0.0)), FlownSlot((4.0, 0.0, 0.0)), FlownSlot(ZERO3)
    together = other(ZERO3, (0.5, 0.0, 0.0), slot=its_slot, makes_way=True)
    found = barrier(own, together, slot)
    rate, reach = -2.0, 4.0 - 0.5 * 0.2
    needed_m = SEPARATION_M + 0.1 * 2.0  # late by a tenth of a second
    assert found.required_m == pytest.approx(needed_m)
    allowed_m_s, slope_1_s = approach_speed(reach - needed_m, 2.0 * BRAKING_M_S2, 4.0, 1.5)
    least = 5.0 * (-rate - allowed_m_s) + slope_1_s * -rate
    assert found.constraint == pytest.approx((1.0, 0.0, 0.0, 0.5 * least, Rank.VEHICLE))
    assert found.constraint_without_margins is None
    for comes_m_s2, share in ((-5.0, 0.5), (5.0, None)):  # one that flees takes no more than its half off
        moves: Vector3 = (0.5 - 0.2 * comes_m_s2, 0.0, 0.0)
        turned = replace(
            together, last=(ZERO3, moves, (comes_m_s2, 0.0, 0.0)), commanded_enu_m_s2=(comes_m_s2, 0.0, 0.0)
        )
        now = barrier(Ahead((4.0 - 0.04 * comes_m_s2, 0.0, 0.0), (-1.5, 0.0, 0.0)), turned, slot)
        expected = 0.5 * least if share else least + comes_m_s2
        assert now.constraint[3] == pytest.approx(expected)


def test_of_two_that_cooperate_the_command_of_the_other_counts_before_its_attitude_shows_it() -> None:
    """Else both do all of it, until each sees the other tilt: a pair that presses each other would swing."""
    own, slot = Ahead((4.0, 0.0, 0.0), (-1.5, 0.0, 0.0)), FlownSlot((4.0, 0.0, 0.0))
    still = other(ZERO3, (0.5, 0.0, 0.0), slot=FlownSlot(ZERO3), makes_way=True)
    comes = replace(still, commanded_enu_m_s2=(5.0, 0.0, 0.0))
    asked, more = (barrier(own, one, slot) for one in (still, comes))
    assert more.constraint[3] == pytest.approx(2.0 * asked.constraint[3] + 5.0)
    assert more.margin_m == asked.margin_m


def test_between_its_last_packet_in_time_and_silence_a_vehicle_in_formation_is_kept_farther_away() -> None:
    """On top of what the delay costs two that close in."""
    slot = FlownSlot((4.0, 0.0, 0.0))
    late = [other(ZERO3, slot=FlownSlot(ZERO3), makes_way=True, age_s=age_s) for age_s in (0.1, 0.3)]
    for closing_m_s in (0.0, 2.0):
        own = Ahead((4.0, 0.0, 0.0), (-closing_m_s, 0.0, 0.0))
        in_time_m, late_m = (barrier(own, one, slot).required_m for one in late)
        assert (in_time_m, late_m - in_time_m) == pytest.approx((SEPARATION_M + 0.1 * closing_m_s, 0.25 * 0.2))


def test_a_turn_away_is_believed_for_a_tenth_of_a_second() -> None:
    flees = other(ZERO3, (-0.5, 0.0, 0.0), (-2.0, 0.0, 0.0))
    own = Ahead((4.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    found = []
    for age_s in (0.1, 0.1001):
        moved = Ahead((4.0 - 0.5 * age_s, 0.0, 0.0), (-1.0 - 2.0 * age_s, 0.0, 0.0))
        found.append(barrier(moved, replace(flees, age_s=age_s)).constraint[3])
    assert found[1] - found[0] == pytest.approx(2.0, abs=0.01)
    for comes_m_s2 in (2.0, 0.5):
        flown: Vector3 = (comes_m_s2, 0.0, 0.0)
        comes = replace(flees, last=(ZERO3, (0.5, 0.0, 0.0), flown), commanded_enu_m_s2=flown)
        believed = [barrier(own, replace(comes, age_s=age_s)).constraint[3] for age_s in (0.1, 0.1001)]
        assert believed[1] == pytest.approx(believed[0], abs=0.01)


@pytest.mark.parametrize(("own", "one"), STATES)
def test_without_the_margins_less_is_asked_by_a_higher_rank(own: Ahead, one: Other) -> None:
    """The margins are errors, growth and leaps: not what the delay and the turn cost."""
    exact, found = barrier(own, one), barrier(own, replace(one, error=PositionError(0.3, 0.2)))
    assert found.constraint[4] is Rank.MARGIN and exact.constraint[4] is Rank.VEHICLE
    assert found.constraint_without_margins == pytest.approx(exact.constraint)
    assert found.constraint[3] >= exact.constraint[3]
    assert found.required_m > exact.required_m
    anywhere = barrier(own, replace(one, rank=Rank.MARGIN))  # where it is is a margin as a whole
    assert anywhere.constraint == pytest.approx((*exact.constraint[:4], Rank.MARGIN))
    uncertain = barrier(own, replace(one, rank=Rank.MARGIN, error=PositionError(0.3, 0.2))).constraint_without_margins
    assert uncertain is not None and uncertain[4] is Rank.MARGIN


def test_a_silent_vehicle_counts_where_it_may_be_and_not_ahead_of_that() -> None:
    """One that brakes before this one: as a fresh one would whose packet, by its lag younger, says so.

    But for the turn of the line to it: the place is the end of a way, and who passes the end may come to the middle.
    """
    silence = Silence(0.3, 0.0, 1.0, BRAKING_M_S2, 8.0)
    last: Motion = ((0.0, 0.0, 0.0), (3.0, 0.0, 0.1), (0.3, 0.0, 0.0))
    at_enu_m, off_m_s = (-4.0, 0.5, 0.3), (0.0, 0.4, 0.0)
    place, flies, slows = nearest_on_way(Ahead(at_enu_m, ZERO3), last, 0.9, LAG_S, silence, 1.0)
    assert flies[0] > 1.0 and slows[0] < 0.0
    towards = [0.3 * (there - here) for there, here in zip(place, at_enu_m, strict=True)]
    straight, aside = [
        Ahead(at_enu_m, tuple(a + b + share * c for a, b, c in zip(flies, towards, off_m_s, strict=True)))
        for share in (0.0, 1.0)
    ]
    silent = barrier(straight, other(*last, age_s=0.9, silence=silence))
    same = barrier(straight, other(place, flies, slows, age_s=-LAG_S))
    assert silent.constraint == pytest.approx(same.constraint)
    assert silent.required_m == pytest.approx(same.required_m)
    assert silent.offset_enu_m == pytest.approx(same.offset_enu_m)
    silent = barrier(aside, other(*last, age_s=0.9, silence=silence))
    same = barrier(aside, other(place, flies, slows, age_s=-LAG_S))
    assert same.required_m > silent.required_m and silent.constraint[3] > same.constraint[3] + 0.01
    heard = replace(silence, begins_s=-inf)
    assert barrier(aside, other(*last, age_s=0.9, silence=heard)).constraint == pytest.approx(same.constraint)


# ---------------------------------------------------------------- the distance that is kept

FAR: Vector3 = (-9.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("own", "its", "position_enu_m", "margin_m"),
    [
        (NO_ERROR, NO_ERROR, FAR, 0.0),
        (PositionError(0.3, 9.0), PositionError(0.4, 9.0), FAR, 0.5),
        (PositionError(0.0, 0.6), PositionError(0.0, 0.8), (0.0, 0.0, 9.0), 1.0),
        (PositionError(0.3, 0.3), PositionError(0.4, 0.4), (5.4, 0.0, 7.2), 0.5 + 0.8 * 0.5),
        (PositionError(5.0, 0.0), PositionError(0.5, 0.0), FAR, 2.0),
        (PositionError(0.5, 0.0), PositionError(99.0, 9.0), FAR, 2.0),
    ],
)
def test_errors_of_both_count_along_the_line_up_to_one_separation(
    own: PositionError, its: PositionError, position_enu_m: Vector3, margin_m: float
) -> None:
    assert required_m(other(position_enu_m, error=its), error=own) == pytest.approx(SEPARATION_M + ALONE_M + margin_m)


def test_the_error_of_traffic_has_a_bound_of_its_own() -> None:
    """It counts in whole, and the own one up to one separation."""
    for own_m, its_m, margin_m in ((0.3, 0.4, 0.5), (3.0, 4.0, 5.0), (9.0, 3.0, 5.0)):
        crane = other(FAR, key="crane", error=PositionError(its_m, 0.0))
        found = required_m(crane, error=PositionError(own_m, 0.0))
        assert found == pytest.approx(SEPARATION_M + ALONE_M + margin_m)
    above = other((0.0, 0.0, 9.0), key="crane", error=PositionError(1.0, 2.0))
    found = required_m(above, error=PositionError(9.0, 9.0))
    assert found == pytest.approx(SEPARATION_M + ALONE_M + SEPARATION_M + 3.0)


@pytest.mark.parametrize(("age_s", "growth_m"), [(0.9, 0.0), (2.0, 0.25), (4.9, 0.975), (5.1, 1.0), (60.0, 1.0)])
def test_from_a_silent_vehicle_more_is_kept_up_to_half_a_separation(age_s: float, growth_m: float) -> None:
    silence = Silence(0.3, 0.0, 1.0, BRAKING_M_S2, 8.0, leaps_m=0.2)
    assert required_m(other(FAR, age_s=age_s, silence=silence)) == pytest.approx(
        SEPARATION_M + ALONE_M + growth_m + 0.2
    )


def test_margins_add_up_and_a_slot_alone_changes_nothing() -> None:
    silence = Silence(0.3, 0.0, 1.0, BRAKING_M_S2, 8.0)
    one = other(FAR, age_s=2.0, silence=silence, error=PositionError(0.3, 0.0))
    for slot in (None, FlownSlot(ZERO3)):
        assert required_m(one, slot) == pytest.approx(SEPARATION_M + ALONE_M + 0.3 + 0.25)
    together = other(FAR, slot=FlownSlot(FAR), makes_way=True, error=PositionError(0.3, 0.0))
    assert required_m(together) == pytest.approx(SEPARATION_M + 0.3)


def slots(own_enu_m: Vector3, its_enu_m: Vector3, **changes: float) -> tuple[FlownSlot, FlownSlot]:
    return FlownSlot(own_enu_m), replace(FlownSlot(its_enu_m), **changes)


def test_margins_take_half_of_what_two_slots_are_farther_apart() -> None:
    """Slots 3 m apart leave half a metre, in the metric of the separation; nearer ones the more, the less they can be flown."""
    error = PositionError(0.0, 0.0)
    for apart_m, error_m, margin_m in (
        (3.0, 0.4, 0.4),
        (3.0, 0.6, 0.5),
        (1.0, 0.4, 0.4),
        (1.0, 0.6, 0.5),
        (2.0, 0.6, 0.0),
    ):
        own, its = slots(ZERO3, (-apart_m, 0.0, 0.0))
        one = other((-apart_m, 0.0, 0.0), slot=its, makes_way=True, error=PositionError(error_m, 0.0))
        assert required_m(one, own, error) == pytest.approx(SEPARATION_M + margin_m)
    own, its = slots(ZERO3, (0.0, -1.8, 4.8))
    one = other((0.0, -1.8, 4.8), slot=its, makes_way=True, height_weight=0.5, error=PositionError(0.6, 0.0))
    assert required_m(one, own, error) == pytest.approx(SEPARATION_M + 0.5)  # 1.8 m and half of 4.8 m


def test_moving_slots_get_room_for_late_tracking() -> None:
    for own_s, its_s, margin_m in ((0.0, 0.0, 0.0), (0.1, 0.0, 0.1), (0.0, 0.1, 0.1)):
        own = FlownSlot(ZERO3, moves_for_s=own_s)
        one = other((-4.0, 0.0, 0.0), slot=FlownSlot((-4.0, 0.0, 0.0), moves_for_s=its_s), makes_way=True)
        assert required_m(one, own) == pytest.approx(SEPARATION_M + margin_m)


@pytest.mark.parametrize(
    ("off_enu_m", "weight", "room_m"),
    [
        ((0.0, 0.5, 0.0), 1.0, 0.0),
        ((0.0, 0.6, 0.0), 1.0, 0.05),
        ((-0.3, 0.4, 0.2), 1.0, 0.5 * (sqrt(0.29) - 0.5)),
        ((0.0, 0.0, -1.2), 0.5, 0.05),
        ((0.0, 0.9, 0.0), 1.0, 0.2),
        ((0.0, 5.0, 0.0), 1.0, 0.2),
    ],
)
def test_vehicles_that_are_not_placed_as_their_slots_get_room_to_pass(
    off_enu_m: Vector3, weight: float, room_m: float
) -> None:
    own, its = slots(ZERO3, (-4.0, 0.0, 0.0))
    at = (-4.0 + off_enu_m[0], off_enu_m[1], off_enu_m[2])
    one = other(at, slot=its, makes_way=True, height_weight=weight)
    assert required_m(one, own) == pytest.approx(SEPARATION_M + room_m)


def test_room_to_pass_widens_what_margins_may_take() -> None:
    """Slots at the separation leave nothing; two that are 2.5 m off them leave a metre."""
    own, its = slots(ZERO3, (-2.0, 0.0, 0.0))
    one = other((-2.0, 2.5, 0.0), slot=its, makes_way=True, error=PositionError(0.9, 0.0))
    assert required_m(one, own) == pytest.approx(SEPARATION_M + 1.0)


def test_what_is_late_and_what_pursues_needs_more_room() -> None:
    """0.1 s of the closing speed; of one that makes no way 0.4 s of its own approach, where that is more."""
    own = Ahead((6.0, 0.0, 0.0), (-2.0, 0.0, 0.0))
    for moves_m_s, makes_way, late_m in ((0.1, False, 0.21), (1.0, False, 0.4), (1.0, True, 0.3), (-3.0, False, 0.0)):
        found = barrier(own, other((0.0, 0.0, 0.0), (moves_m_s, 0.0, 0.0), makes_way=makes_way))
        assert found.required_m == pytest.approx(SEPARATION_M + ALONE_M + late_m)
    slow = barrier(Ahead((6.0, 0.0, 0.0), (-0.5, 0.0, 0.0)), other(ZERO3, makes_way=True))
    assert slow.required_m == pytest.approx(SEPARATION_M + ALONE_M + 0.05)
    oblique = barrier(Ahead((3.6, 4.8, 0.0), ZERO3), other(ZERO3, (0.6, 0.8, 0.0)))
    assert oblique.required_m == pytest.approx(SEPARATION_M + ALONE_M + 0.4)
    up = Ahead((0.0, 0.0, 12.0), ZERO3)
    found = barrier(up, other(ZERO3, (0.0, 0.0, 2.0), height_weight=0.5))
    assert found.required_m == pytest.approx(SEPARATION_M + ALONE_M + 0.4 * 1.0)


def test_a_pair_that_turns_about_each_other_needs_more_room() -> None:
    """Half of the lag squared times v^2/d."""
    found = barrier(Ahead((4.0, 0.0, 0.0), (0.0, 3.0, 0.0)), other(ZERO3))
    assert found.required_m == pytest.approx(SEPARATION_M + ALONE_M + 0.02 * 9.0 / 4.1)


# ---------------------------------------------------------------- very near, and below


def test_at_a_quarter_of_the_separation_the_way_out_is_sideways_and_kept() -> None:
    separation = Separation(SETTINGS)

    def leaves(east_m: float, north_m: float, up_m: float, side: float = 1.0) -> Vector3:
        at = Ahead((east_m, north_m, up_m), ZERO3)
        return separation.barrier(at, NO_ERROR, None, other(ZERO3, side=side)).constraint[:3]

    assert leaves(0.3, 0.4, 0.001)[2] > 0.0  # just farther away
    assert leaves(0.24, 0.32, 0.1) == pytest.approx((0.6, 0.8, 0.0))
    assert leaves(-0.3, 0.0, 0.0) == pytest.approx((0.6, 0.8, 0.0))
    leaves(0.0, 0.0, 9.0)
    assert leaves(0.0, 0.05, 0.0, -1.0) == (-1.0, 0.0, 0.0)
    leaves(0.0, 0.0, 9.0)
    assert leaves(0.0, 0.051, 0.0) == pytest.approx((0.0, 1.0, 0.0))
    leaves(0.0, 0.0, 9.0)
    assert leaves(0.051, 0.0, 0.0, -1.0) == pytest.approx((1.0, 0.0, 0.0))


def test_each_vehicle_that_is_near_has_a_way_out_of_its_own() -> None:
    separation, far = Separation(SETTINGS), Ahead((9.0, 9.0, 9.0), ZERO3)
    near = Ahead((0.3, 0.0, 0.0), ZERO3)
    separation.barrier(near, NO_ERROR, None, other(ZERO3, key=4))
    separation.barrier(far, NO_ERROR, None, other(ZERO3, key=5))
    kept = separation.barrier(Ahead((0.0, 0.3, 0.0), ZERO3), NO_ERROR, None, other(ZERO3, key=4))
    assert kept.constraint[:3] == (1.0, 0.0, 0.0)


def test_sideways_the_direction_does_not_turn() -> None:
    separation = Separation(SETTINGS)
    at = Ahead((0.2, 0.0, 0.0), (0.0, 2.0, 0.0))
    found = separation.barrier(at, NO_ERROR, None, other(ZERO3))
    assert found.required_m == pytest.approx(SEPARATION_M + ALONE_M)
    assert found.constraint[3] == pytest.approx(5.0 * 1.5)


SILENT = Silence(0.3, 0.0, 1.0, BRAKING_M_S2, 8.0)


def below(ahead: Ahead, one: Other, error: PositionError = NO_ERROR) -> list[Barrier]:
    return Separation(SETTINGS).barriers_below(ahead, error, None, [one])


def test_below_a_silent_vehicle_a_horizontal_distance_is_kept() -> None:
    """2.5 s after its last setpoint it may be 3.15 m lower: the room has grown to 1.5 m."""
    own, one = Ahead((3.0, 4.0, 2.0), (0.3, -0.2, 0.4)), other((0.0, 0.0, 5.0), age_s=2.5, silence=SILENT)
    (found,) = below(own, one)
    assert found.below and found.other is one and found.offset_enu_m == pytest.approx((3.0, 4.0, -3.0))
    assert found.required_m == pytest.approx(1.5)
    closing_m_s, across_m_s = 1.0 - (0.6 * 0.3 - 0.8 * 0.2), 0.6 * -0.2 - 0.8 * 0.3
    assert found.margin_m == pytest.approx(3.5)
    allowed_m_s, slope_1_s = approach_speed(3.5, 0.6 * BRAKING_M_S2, 4.0, 1.5)
    least = 5.0 * (closing_m_s - allowed_m_s) + slope_1_s * closing_m_s - across_m_s**2 / 5.1
    assert found.constraint == pytest.approx((0.6, 0.8, 0.0, least, Rank.MARGIN))


def test_below_one_that_moves_on_the_distance_is_kept_from_where_it_may_be() -> None:
    own = Ahead((30.0, 3.0, 2.0), (0.0, -1.0, 0.0))
    one = other((0.0, 0.0, 5.0), (3.0, 1.0, 0.0), (0.5, 0.5, 0.0), age_s=2.5, silence=SILENT)
    point = nearest_on_way(own, one.last, one.age_s, LAG_S, SILENT, 1.0)
    (found,) = below(own, one)
    (x, y, _), (vx, vy, _), (ax, ay, _) = point
    assert found.offset_enu_m[:2] == pytest.approx((30.0 - x, 3.0 - y))
    nx, ny = (30.0 - x) / hypot(30.0 - x, 3.0 - y), (3.0 - y) / hypot(30.0 - x, 3.0 - y)
    still = other((x, y, 5.0), age_s=2.5, silence=SILENT)
    (same,) = below(Ahead(own.position_enu_m, (-vx, -1.0 - vy, 0.0)), still)
    assert found.constraint[3] == pytest.approx(same.constraint[3] + nx * ax + ny * ay)


@pytest.mark.parametrize(
    ("own_enu_m", "changes", "counts"),
    [
        ((1.0, 0.0, 2.0), {}, True),
        ((1.0, 0.0, 5.0), {}, False),  # as high
        ((1.0, 0.0, 2.0), {"age_s": 1.5}, True),
        ((1.0, 0.0, 2.0), {"age_s": 1.0}, False),  # it keeps its attitude
        ((1.0, 0.0, 2.0), {"silence": replace(SILENT, lands=False)}, False),
        ((1.0, 0.0, 2.0), {"silence": None}, False),
        ((1.0, 0.0, -95.0), {"height_weight": 0.5}, False),  # far above
    ],
)
def test_which_vehicles_are_above(own_enu_m: Vector3, changes: dict[str, object], counts: bool) -> None:
    one = replace(other((0.0, 0.0, 5.0), age_s=2.5, silence=SILENT), **changes)
    assert bool(below(Ahead(own_enu_m, ZERO3), one)) is counts


def test_straight_below_each_leaves_to_its_own_side() -> None:
    for side in (1.0, -1.0):
        (found,) = below(Ahead((0.0, 0.0, 2.0), ZERO3), other((0.0, 0.0, 5.0), age_s=9.0, silence=SILENT, side=side))
        assert found.constraint == pytest.approx((side, 0.0, 0.0, 5.0 * 1.5, Rank.MARGIN))
        assert found.required_m == pytest.approx(SEPARATION_M + 1.0 + ALONE_M)
    tall = other((0.0, 0.0, 5.0), age_s=9.0, silence=SILENT, error=PositionError(0.3, 0.4))
    (found,) = below(Ahead((0.0, 0.0, 2.0), ZERO3), tall, PositionError(0.4, 0.3))
    assert found.required_m == pytest.approx(SEPARATION_M + 1.0 + ALONE_M + 0.5)  # no error of a height counts


# ---------------------------------------------------------------- what is reported, and the turn to the right


def test_the_nearest_by_its_margin_is_reported_at_its_present_distance() -> None:
    vehicle = VehicleState(position_enu_m=(1.0, 0.0, 0.0), velocity_enu_m_s=(0.0, 1.0, 0.0), position_time_s=9.9)
    near = barrier(Ahead((1.0, 0.1, 0.0), ZERO3), other((4.5, 0.1, 0.0), (-1.0, 0.0, 0.0), age_s=0.5, key=4))
    doubt = replace(other((1.0, 4.1, 0.0), key=5), error=PositionError(1.9, 0.0))
    nearest, violated = nearest_and_violated(10.0, vehicle, [near, barrier(Ahead((1.0, 0.1, 0.0), ZERO3), doubt)], 2.0)
    assert nearest is not None and not violated
    assert (nearest.name, nearest.distance_m) == ("5", pytest.approx(4.0))
    assert nearest.required_m == pytest.approx(SEPARATION_M + ALONE_M + 1.9)
    nearest, violated = nearest_and_violated(10.0, vehicle, [near], 3.0)
    assert nearest is not None and not violated
    assert (nearest.name, nearest.distance_m) == ("4", pytest.approx(3.0))
    assert nearest_and_violated(10.0, vehicle, [near], 3.0001)[1]
    assert nearest_and_violated(10.0, vehicle, [], 2.5) == (None, False)


def test_a_silent_vehicle_is_reported_where_it_was_when_it_may_first_have_turned() -> None:
    vehicle = VehicleState(position_enu_m=(9.0, 0.0, 4.0), position_time_s=10.0)
    one = other(ZERO3, (1.0, 0.0, 0.0), age_s=7.0, silence=SILENT, height_weight=0.5)
    found = barrier(Ahead((9.0, 0.0, 4.0), ZERO3), one)
    nearest, _ = nearest_and_violated(10.0, vehicle, [found], 2.0)
    assert nearest is not None and nearest.distance_m == pytest.approx(hypot(8.0, 2.0))
    lower = replace(found, below=True, margin_m=-9.0, other=replace(one, key=7))
    assert nearest_and_violated(10.0, vehicle, [found, lower], 2.0)[0] == nearest


def test_distances_are_those_of_both_at_present() -> None:
    vehicle = VehicleState(position_enu_m=(1.0, 2.0, 3.0), velocity_enu_m_s=(2.0, -1.0, 3.0), position_time_s=9.9)
    one = other((4.0, -2.0, 9.0), (0.5, -1.5, 2.5), (9.0, 9.0, 9.0), age_s=0.2, height_weight=0.5)
    apart_m = hypot(1.2 - 4.1, 1.9 + 2.3, 0.5 * (3.3 - 9.5))
    for separation_m, is_violated in ((0.999 * apart_m, False), (1.001 * apart_m, True)):
        nearest, violated = nearest_and_violated(10.0, vehicle, [barrier(Ahead(ZERO3, ZERO3), one)], separation_m)
        assert nearest is not None and nearest.distance_m == pytest.approx(apart_m)
        assert violated is is_violated


def plane(normal: Vector3, least: float, one: Other | None = None, offset_enu_m: Vector3 = (3.0, 0.0, 0.0)) -> Barrier:
    """Of a vehicle in formation, unless it is given; 2 m are required of it."""
    return Barrier((*normal, least, Rank.VEHICLE), one or other(ZERO3, slot=FlownSlot(ZERO3)), offset_enu_m, 2.0, 1.0)


def test_what_is_removed_is_the_most_of_any_vehicle() -> None:
    planes = [plane((1.0, 0.0, 0.0), -1.0), plane((0.0, 0.6, 0.8), 0.5), plane((0.0, -1.0, 0.0), -9.0)]
    assert largest_removed_m_s2((-3.0, 2.0, -2.0), planes) == pytest.approx(2.0)
    assert largest_removed_m_s2((0.0, 2.0, -2.0), planes) == pytest.approx(0.9)
    assert largest_removed_m_s2((9.0, 2.0, 9.0), planes) == 0.0


def near(normal: Vector3, commanded_enu_m_s2: Vector3 = ZERO3, margin_m: float = 0.0, below: bool = False) -> Barrier:
    """Of a vehicle with this margin and command."""
    one = replace(other(ZERO3, slot=FlownSlot(ZERO3)), commanded_enu_m_s2=commanded_enu_m_s2)
    return replace(plane(normal, -9.0, one), margin_m=margin_m, below=below)


EAST, NORTH = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)


def test_a_vehicle_pulls_gently_towards_one_that_is_near() -> None:
    """By 2 m/s^2 and 4 m/s^2 for each metre left, more or less by what the other one commands; along other axes as wanted."""
    wanted = (-5.0, 3.0, 1.0)
    assert eased(wanted, [near(EAST)]) == pytest.approx((-2.0, 3.0, 1.0))
    assert eased(wanted, [near(EAST, margin_m=-0.4)]) == pytest.approx((-2.0, 3.0, 1.0))
    assert eased(wanted, [near(EAST, margin_m=0.4)]) == pytest.approx((-3.6, 3.0, 1.0))
    assert eased(wanted, [near(EAST), near((0.0, -1.0, 0.0))]) == pytest.approx((-2.0, 2.0, 1.0))
    assert eased(wanted, [near(EAST, (-1.5, 9.0, 9.0))]) == pytest.approx((-3.5, 3.0, 1.0))
    assert eased(wanted, [near(EAST, (0.5, 9.0, 9.0))]) == pytest.approx((-1.5, 3.0, 1.0))
    assert eased(wanted, [near((0.6, 0.0, -0.8), (0.0, -9.0, 0.0))]) == pytest.approx((-3.92, 3.0, -0.44))
    assert eased(wanted, [near((0.6, 0.0, -0.8), (-1.0, 0.0, 1.0))]) == pytest.approx((-4.76, 3.0, 0.68))
    assert eased((-5.0, -3.0, 1.0), [near((0.6, 0.8, 0.0), (0.0, 1.0, 0.0))]) == pytest.approx((-2.48, 0.36, 1.0))
    assert eased((-30.0, 0.0, 0.0), [near(EAST, margin_m=4.49)]) == pytest.approx((-19.96, 0.0, 0.0))


def test_the_order_of_the_others_changes_no_pull() -> None:
    """The largest excess, towards the north-east, is taken off first: then nothing of the pull north exceeds its bound."""
    wanted, barriers = (-5.0, -4.0, 1.0), [near(EAST), near((0.6, 0.8, 0.0), margin_m=0.1), near(NORTH, margin_m=0.2)]
    found = {eased(wanted, order) for order in permutations(barriers)}
    assert found == {eased(wanted, barriers)}
    assert eased(wanted, barriers) == pytest.approx((-2.0, -0.96, 1.0))


def test_a_false_acceleration_leaves_a_pull_of_1_m_s2() -> None:
    wanted = (-5.0, 3.0, 1.0)
    assert eased(wanted, [near(EAST, (15.0, 0.0, 0.0))]) == pytest.approx((-1.0, 3.0, 1.0))
    assert eased(wanted, [near(EAST, (2.5, 0.0, 0.0))]) == pytest.approx((-1.0, 3.0, 1.0))
    assert eased(wanted, [near(EAST, (15.0, 0.0, 0.0), margin_m=0.25)]) == pytest.approx((-2.0, 3.0, 1.0))
    assert eased(wanted, [near(EAST, (-15.0, 0.0, 0.0))]) is wanted
    gentle = (-1.0, 0.0, 0.0)
    assert eased(gentle, [near(EAST, (15.0, 0.0, 0.0))]) is gentle


def test_no_pull_is_eased_where_there_is_room_or_below_a_silent_vehicle() -> None:
    wanted = (-5.0, 3.0, 1.0)
    assert eased(wanted, [near(EAST, margin_m=0.75)]) is wanted
    assert eased((-30.0, 0.0, 0.0), [near(EAST, margin_m=4.5)]) == (-30.0, 0.0, 0.0)
    assert eased(wanted, [near(EAST, below=True)]) is wanted
    assert eased((-2.0, 3.0, 1.0), [near(EAST)]) == (-2.0, 3.0, 1.0)
    assert eased(wanted, []) is wanted


GAINS = Gains(2.0, 1.5)


def test_a_vehicle_turns_right_of_what_blocks_its_way_by_what_that_takes() -> None:
    """0.8 of it; up to 2 m/s^2 for all of them; an acceleration that is asked away is no part of it."""
    wanted = (-1.0, 0.0, 0.5)
    assert turn_right(wanted, ZERO3, GAINS, [plane((1.0, 0.0, 0.0), -0.25)]) == pytest.approx((0.0, 0.6))
    assert turn_right(wanted, ZERO3, GAINS, [plane((1.0, 0.0, 0.0), 5.0)]) == pytest.approx((0.0, 0.8))
    assert turn_right(wanted, ZERO3, GAINS, [plane((1.0, 0.0, 0.0), -1.0)]) == (0.0, 0.0)
    assert turn_right(wanted, ZERO3, GAINS, [plane((-1.0, 0.0, 0.0), -5.0)]) == (0.0, 0.0)
    assert turn_right(wanted, ZERO3, GAINS, [plane((0.0, 0.6, -0.8), 0.0)]) == pytest.approx((-0.8 * 0.4 * 0.6, 0.0))
    oblique = turn_right((-0.5, -0.7, 0.3), ZERO3, GAINS, [plane((0.48, 0.64, 0.6), 0.1)])
    removed = 0.48 * 0.5 + 0.64 * 0.7 - 0.6 * 0.3
    assert oblique == pytest.approx((-0.8 * removed * 0.64, 0.8 * removed * 0.48))
    both = [plane((-1.0, 0.0, 0.0), -9.0), plane((1.0, 0.0, 0.0), 0.0), plane((0.8, 0.6, 0.0), 0.0)]
    assert turn_right(wanted, ZERO3, GAINS, both) == pytest.approx((-0.64 * 0.6, 0.8 + 0.64 * 0.8))
    x, y = turn_right((-9.0, 0.0, 0.0), ZERO3, GAINS, both)
    assert hypot(x, y) == pytest.approx(2.0)
    assert x / y == pytest.approx(-0.64 * 0.6 / (0.8 + 0.64 * 0.8))


@pytest.mark.parametrize(
    ("beyond_m", "velocity", "moves", "share"),
    [
        (3.0, ZERO3, ZERO3, 1.0),
        (0.0, ZERO3, ZERO3, 0.0),  # it is on the goal
        (2.0, ZERO3, ZERO3, 0.0),  # the goal is within the distance that is required of it
        (2.5, ZERO3, ZERO3, 0.5),
        (2.5, (-0.8, -0.6, 0.0), ZERO3, 0.5),  # at any speed
        (2.5, (-0.4, 0.3, 0.0), (0.0, 0.0, 0.9), 0.5),
        (0.0, ZERO3, (0.09, -0.12, 0.0), 0.15),  # it leaves the goal
        (2.5, (0.1, 0.0, 0.0), (0.24, -0.32, 0.0), 0.5),
        (0.0, ZERO3, (2.4, -3.2, 0.0), 1.0),
        (3.0, (0.126, -0.168, 0.0), ZERO3, -1.0),  # it is passed on the other side already, by 0.21 m/s
        (3.0, (0.114, -0.152, 0.0), ZERO3, 1.0),
        (3.0, (0.126, -0.168, 0.0), (0.012, -0.016, 0.0), 1.0),
        (3.0, (0.114, -0.152, 0.0), (-0.012, 0.016, 0.0), -1.0),
    ],
)
def test_a_vehicle_that_does_not_make_way_is_passed_but_not_circled(
    beyond_m: float, velocity: Vector3, moves: Vector3, share: float
) -> None:
    """It is 3 m away at (-0.8, -0.6), and the goal `beyond_m` farther: what the law wants is that of the goal."""
    goal = (-0.8 * (3.0 + beyond_m), -0.6 * (3.0 + beyond_m))
    wanted = (2.0 * goal[0] - 1.5 * velocity[0], 2.0 * goal[1] - 1.5 * velocity[1], 0.0)
    along = 0.8 * wanted[0] + 0.6 * wanted[1]
    one = plane((0.8, 0.6, 0.0), along + 1.5, other(ZERO3, moves), (2.4, 1.8, 0.0))
    removed = min(along + 1.5, 0.0) - along
    size = min(0.8 * removed * abs(share), 2.0) * (1.0 if share > 0.0 else -1.0)
    assert turn_right(wanted, velocity, GAINS, [one]) == pytest.approx((-0.6 * size, 0.8 * size), abs=1e-12)
