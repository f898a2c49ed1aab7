"""Named shapes, the ways between them, and a vehicle's plan of which slot it flies."""

from __future__ import annotations

from collections.abc import Callable
from math import dist, hypot, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.core.formation_limits import FormationLimits
from companion.core.slot_plan import SlotPlan
from companion.geometry.curves import Motion, between, circle, duration_s, way
from companion.geometry.shapes import SHAPES, slots_of
from companion.geometry.transition import closest, fastest_m_s
from companion.ground.formations import assigned
from companion.types import (
    ZERO3,
    FlightPhase,
    FlownSlot,
    FormationChange,
    PeerPacket,
    Role,
    Vector3,
)

SIZES = (1, 2, 3, 4, 5, 6, 7, 8, 12, 25)
LINE: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (-2.0, 0.0, 0.0), 3: (-4.0, 0.0, 0.0)}
TURNED: dict[int, Vector3] = {1: (0.0, 0.0, 0.0), 2: (0.0, -2.0, 0.0), 3: (0.0, -4.0, 0.0)}
FENCE = ((-20.0, -20.0, 0.0), (20.0, 20.0, 20.0))
CHANGE = FormationChange(1, tuple(TURNED.items()), begins_s=10.0, lasts_s=20.0)


# ---------------------------------------------------------------- shapes


@pytest.mark.parametrize("name", SHAPES)
def test_every_shape_has_its_spacing_and_turns_as_a_whole(name: str) -> None:
    for n in SIZES:
        slots, turned = (slots_of(SHAPES[name], n, 3.0, heading) for heading in (0.0, pi / 2.0))
        assert len(slots) == n
        if n > 1:
            assert min(dist(a, b) for i, a in enumerate(slots) for b in slots[:i]) == pytest.approx(3.0)
        for (x, y, z), there in zip(slots, turned, strict=True):
            assert there == pytest.approx((-y, x, z))


def test_shapes_look_like_their_names() -> None:
    assert slots_of(SHAPES["line"], 3, 2.0, 0.0) == pytest.approx(np.array([(0, 2, 0), (0, 0, 0), (0, -2, 0)]))
    assert slots_of(SHAPES["column"], 3, 2.0, 0.0) == pytest.approx(np.array([(0, 0, 0), (-2, 0, 0), (-4, 0, 0)]))
    root = sqrt(2.0)
    corners = np.array([(root, 0, 0), (0, root, 0), (-root, 0, 0), (0, -root, 0)])
    assert slots_of(SHAPES["diamond"], 4, 2.0, 0.0) == pytest.approx(corners)
    assert [hypot(x, y) for x, y, _ in slots_of(SHAPES["circle"], 6, 2.0, 0.0)] == pytest.approx([2.0] * 6)
    six = slots_of(SHAPES["rectangle"], 6, 2.0, 0.0)
    assert {(round(x), round(y)) for x, y, _ in six} == {(x, y) for x in (-2, 0, 2) for y in (-1, 1)}
    assert {round(z, 6) for _, _, z in slots_of(SHAPES["layers"], 8, 2.0, 0.0)} == {0.0, 2.0}


def test_nobody_flies_right_under_another() -> None:
    for n in SIZES:
        ground = [(round(x, 6), round(y, 6)) for x, y, _ in slots_of(SHAPES["layers"], n, 2.0, 0.0)]
        assert len(set(ground)) == n


# ---------------------------------------------------------------- ways


@pytest.mark.parametrize("n", [2, 4, 8, 13])
def test_assigned_ways_keep_what_is_promised_between_any_two_shapes(n: int) -> None:
    """1/sqrt(2) of the spacing."""
    for before in SHAPES:
        start = dict(enumerate(slots_of(SHAPES[before], n, 3.0, 0.0)))
        for after in SHAPES:
            goal = assigned(start, slots_of(SHAPES[after], n, 3.0, 0.4))
            assert sorted(goal.values()) == sorted(slots_of(SHAPES[after], n, 3.0, 0.4))
            assert closest(start, goal)[0] >= 3.0 / sqrt(2.0) - 1e-9, (before, after)


coordinates = st.floats(-20, 20)
points = st.tuples(coordinates, coordinates, coordinates)


@given(points, points, points, points)
def test_the_closest_approach_is_what_is_flown(a0: Vector3, a1: Vector3, b0: Vector3, b1: Vector3) -> None:
    least_m, i, j = closest({1: a0, 2: b0}, {1: a1, 2: b1})
    flown_m = [dist(between(a0, a1, t, 10.0)[0], between(b0, b1, t, 10.0)[0]) for t in np.linspace(0, 10, 400).tolist()]
    assert (i, j) == (1, 2)
    assert least_m <= min(flown_m) + 1e-9
    assert min(flown_m) <= least_m + 0.5  # between two samples


def test_a_way_lasts_as_long_as_its_limits_ask_for() -> None:
    for way_m in (0.5, 10.0):
        lasts_s = duration_s(way_m, 2.0, 1.0)
        motions = [between(ZERO3, (way_m, 0.0, 0.0), t, lasts_s) for t in np.linspace(0, lasts_s, 2001).tolist()]
        speed, acceleration = (max(abs(m[k][0]) for m in motions) for k in (1, 2))
        assert speed <= 2.0 + 1e-6
        assert acceleration <= 1.0 + 1e-6
        assert max(speed / 2.0, acceleration) == pytest.approx(1.0, abs=1e-3)
        assert fastest_m_s({1: ZERO3}, {1: (way_m, 0.0, 0.0)}, lasts_s) == pytest.approx(speed, rel=1e-4)


@pytest.mark.parametrize(
    "curve",
    [
        lambda t: circle(t, 5.0, 20.0, 4.0),
        lambda t: circle(t, 5.0, -20.0, 4.0),
        way([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 5.0, 2.0)], 1.0, 2.0, 1.0),
    ],
)
def test_velocity_and_acceleration_are_the_derivatives(curve: Callable[[float], Motion]) -> None:
    step_s = 1e-5
    for t in np.arange(0.01, 40.0, 0.05).tolist():
        (_, _, _), velocity, acceleration = curve(t)
        before, after = curve(t - step_s), curve(t + step_s)
        assert (np.subtract(after[0], before[0]) / (2 * step_s)) == pytest.approx(np.array(velocity), abs=1e-5)
        assert (np.subtract(after[1], before[1]) / (2 * step_s)) == pytest.approx(np.array(acceleration), abs=1e-3)


def test_a_way_waits_at_its_points_and_stays_at_the_last() -> None:
    curve = way([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 5.0, 0.0)], 3.0, 2.0, 1.0)
    leg_s = duration_s(10.0, 2.0, 1.0)
    for t in (leg_s, leg_s + 2.9):
        assert curve(t) == ((10.0, 0.0, 0.0), ZERO3, ZERO3)
    assert curve(1e6) == ((10.0, 5.0, 0.0), ZERO3, ZERO3)
    assert curve(-1.0) == (ZERO3, ZERO3, ZERO3)


# ---------------------------------------------------------------- a vehicle's plan


def plan(own_id: int = 2) -> SlotPlan:
    return SlotPlan(own_id, LINE, FormationLimits(1.0, 1.0, FENCE))


def other(vehicle_id: int, formation: int, waiting: int) -> PeerPacket:
    slot = FlownSlot(LINE[vehicle_id], formation=formation, waiting=waiting)
    phase = FlightPhase.FORMATION
    return PeerPacket(vehicle_id, 1, 1, 0, phase, Role.FOLLOWER, ZERO3, ZERO3, ZERO3, 0.0, 0.0, 2, None, slot)


KNOW = [other(1, 0, 1), other(3, 0, 1)]


def test_a_change_begins_at_its_time_where_all_have_it() -> None:
    slots = plan()
    assert slots.obey(CHANGE, 9.0, (), ()) == (True, "formation 1 begins in 1.0 s")
    assert slots.update(9.9, KNOW, in_formation=True) == FlownSlot(LINE[2], formation=0, waiting=1)
    assert slots.update(10.0, KNOW, in_formation=True) == FlownSlot(LINE[2], formation=1, waiting=1)
    assert slots.events == ["formation 0 -> 1"]
    half_way = slots.update(20.0, KNOW, in_formation=True)
    assert half_way.position_enu_m == pytest.approx((-1.0, -1.0, 0.0))
    assert half_way.velocity_enu_m_s == pytest.approx((1.875 * 2.0 / 20.0, -1.875 * 2.0 / 20.0, 0.0))
    assert slots.update(30.0, KNOW, in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_it_does_not_begin_where_one_that_is_heard_missed_it() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    assert slots.update(10.0, [KNOW[0], other(3, 0, 0)], in_formation=True) == FlownSlot(LINE[2])
    assert slots.events == ["formation 1 does not begin: vehicle 3 does not have it"]
    assert slots.update(20.0, KNOW, in_formation=True) == FlownSlot(LINE[2])


def test_who_began_a_tick_sooner_has_it() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    assert slots.update(10.0, [other(1, 1, 1), other(3, 0, 1)], in_formation=True).formation == 1


def test_the_same_change_may_come_again() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    assert slots.obey(CHANGE, 9.5, (), ())[0]
    slots.update(10.0, KNOW, in_formation=True)
    assert slots.obey(CHANGE, 12.0, (), ())[0]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"number": 0}, "number 0 is not newer than 0"),
        ({"number": 5000}, "number 5000 is too far ahead of 0"),
        ({"slots_enu_m": CHANGE.slots_enu_m[:2]}, "slots for vehicles [1, 2]; expected [1, 2, 3]"),
        ({"slots_enu_m": (*CHANGE.slots_enu_m, (3, ZERO3))}, "slots for vehicles [1, 2, 3, 3]; expected [1, 2, 3]"),
        ({"slots_enu_m": ((1, ZERO3), (2, (-0.5, 0.0, 0.0)), (3, LINE[3]))}, "come within 0.50 m of each other"),
        ({"slots_enu_m": ((1, LINE[2]), (2, LINE[1]), (3, LINE[3]))}, "come within 0.00 m of each other"),
        ({"slots_enu_m": ((1, ZERO3), (2, (float("nan"), 0.0, 0.0)), (3, LINE[3]))}, "come within nan m"),
        ({"lasts_s": 5.0}, "slots move at up to 2.1 m/s; expected at most 1 m/s"),
        ({"lasts_s": float("nan")}, "lasts nan s"),
        ({"lasts_s": 0.0}, "lasts 0.0 s"),
        ({"begins_s": 8.9}, "begins at 8.9 s of the fleet's time, which is 9.0 s now"),
        ({"begins_s": 100.0}, "begins at 100.0 s"),
    ],
)
def test_a_change_that_cannot_be_flown_is_refused_and_changes_nothing(changes: dict[str, object], words: str) -> None:
    slots = plan()
    accepted, reason = slots.obey(replace(CHANGE, **changes), 9.0, (), ())
    assert not accepted
    assert words in reason
    assert slots.update(50.0, KNOW, in_formation=True) == FlownSlot(LINE[2])


def test_while_a_formation_is_being_taken_up_no_other_is_taken() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    slots.update(10.0, KNOW, in_formation=True)
    back = FormationChange(2, tuple(LINE.items()), 21.0, 20.0)
    assert slots.obey(back, 20.0, (), ()) == (False, "formation: formation 1 is still being taken up")
    slots.update(30.0, KNOW, in_formation=True)
    assert slots.obey(replace(back, begins_s=31.0), 30.0, (), ())[0]


def test_who_is_alone_takes_up_at_once_what_the_others_fly() -> None:
    slots = plan()
    assert slots.obey(CHANGE, 40.0, [other(1, 1, 1)], ()) == (True, "formation 1, which the others fly")
    assert slots.update(40.0, (), in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_after_landing_the_formation_stays_while_the_time_begins_anew() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    slots.update(10.0, KNOW, in_formation=True)
    slots.begin_anew()
    assert slots.update(0.0, (), in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_where_a_leader_begins_the_time_anew_in_flight_nobody_goes_back_to_an_older_formation() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    slots.update(10.0, KNOW, in_formation=True)
    assert slots.update(40.0, KNOW, in_formation=True).position_enu_m == TURNED[2]
    assert slots.update(39.9, KNOW, in_formation=True).position_enu_m == TURNED[2]
    for reference_s in (0.5, 9.0, 11.0, 15.0):
        assert slots.update(reference_s, KNOW, in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_a_change_that_waits_when_the_vehicle_lands_is_told_of_and_forgotten() -> None:
    slots = plan()
    slots.obey(CHANGE, 9.0, (), ())
    slots.begin_anew()
    assert slots.events == ["formation 1 does not begin: the fleet's time begins anew"]
    assert slots.update(30.0, KNOW, in_formation=True) == FlownSlot(LINE[2])
    slots.begin_anew()
    assert len(slots.events) == 1


def test_on_the_ground_a_formation_is_taken_up_at_once_and_by_all() -> None:
    for own_id in (1, 2, 3):
        slots = plan(own_id)
        assert slots.obey_on_ground(CHANGE, (), ()) == (True, "formation 1, on the ground at once")
        assert slots.update(0.0, (), in_formation=True) == FlownSlot(TURNED[own_id], formation=1, waiting=1)
        assert slots.update(11.0, (), in_formation=True) == FlownSlot(
            TURNED[own_id], formation=1, waiting=1
        )  # nor in the next flight
        assert not slots.events


def test_on_the_ground_slots_must_be_apart_as_well_and_no_way_to_them_counts() -> None:
    swapped = replace(CHANGE, slots_enu_m=((1, LINE[2]), (2, LINE[1]), (3, LINE[3])))
    assert plan().obey_on_ground(swapped, (), ())[0]
    near = replace(CHANGE, slots_enu_m=((1, ZERO3), (2, (-0.5, 0.0, 0.0)), (3, LINE[3])))
    assert "come within 0.50 m" in plan().obey_on_ground(near, (), ())[1]


def test_who_stands_while_others_fly_takes_up_what_they_fly_and_not_before() -> None:
    slots = plan()
    accepted, reason = slots.obey_on_ground(CHANGE, KNOW, ())
    assert (accepted, reason) == (True, "formation 1 is taken over here when the others fly it")
    assert slots.update(0.0, KNOW, in_formation=True) == FlownSlot(LINE[2])
    assert slots.obey_on_ground(CHANGE, [other(1, 1, 1)], ()) == (True, "formation 1, which the others fly")
    assert slots.update(0.0, KNOW, in_formation=True).position_enu_m == TURNED[2]


def test_who_has_a_newer_formation_than_the_others_fly_may_be_given_theirs() -> None:
    slots = plan()
    assert slots.obey_on_ground(replace(CHANGE, number=7), (), ())[0]
    assert slots.obey(CHANGE, 40.0, [other(1, 1, 1)], ())[0]
    assert slots.update(40.0, (), in_formation=True).formation == 1


@pytest.mark.parametrize(
    ("rft_enu_m", "words"),
    [
        ((0.0, -17.0, 5.0), "puts vehicle 3 at y = -21.0 m, outside the fence (-20 to 20)"),
        ((0.0, 0.0, -0.1), "puts vehicle 1 at z = -0.1 m, outside the fence (0 to 20)"),
    ],
)
def test_no_formation_leaves_the_fence(rft_enu_m: Vector3, words: str) -> None:
    inside = (0.0, 0.0, 5.0)
    assert plan().obey(CHANGE, 9.0, (), [inside])[0]
    for refused in (plan().obey(CHANGE, 9.0, (), [inside, rft_enu_m]), plan().obey_on_ground(CHANGE, (), [rft_enu_m])):
        assert not refused[0]
        assert words in refused[1]


def test_a_leader_passes_on_what_waits_and_what_is_flown_while_somebody_lacks_it() -> None:
    slots = plan(1)
    assert slots.to_pass_on([other(2, 0, 0)]) is None
    slots.obey(CHANGE, 9.0, (), ())
    assert slots.to_pass_on(KNOW) == CHANGE
    slots.update(10.0, KNOW, in_formation=True)
    assert slots.to_pass_on([other(2, 1, 1), other(3, 0, 1)]) is None
    assert slots.to_pass_on([other(2, 1, 1), other(3, 0, 0)]) == CHANGE
    assert slots.to_pass_on([other(2, 2, 2)]) == CHANGE  # of one that came to nothing


def test_of_two_with_one_number_the_first_leader_s_counts() -> None:
    slots, same_number = plan(), replace(CHANGE, begins_s=11.0)
    assert slots.lacks(CHANGE, over_own=False)
    slots.obey(CHANGE, 9.0, (), ())
    assert not slots.lacks(CHANGE, over_own=True)
    assert slots.lacks(same_number, over_own=True)
    assert not slots.lacks(same_number, over_own=False)
    assert slots.lacks(replace(CHANGE, number=2), over_own=False)
    assert slots.obey(same_number, 9.0, (), ())[0]
    assert slots.update(10.5, KNOW, in_formation=True).formation == 0
    assert slots.update(11.0, KNOW, in_formation=True).formation == 1
    assert not slots.lacks(same_number, over_own=True)
