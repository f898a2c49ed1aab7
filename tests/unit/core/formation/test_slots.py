"""Named shapes, the ways between them, and slot plan of one vehicle of which slot it flies."""

from __future__ import annotations

from collections.abc import Callable, Collection
from math import dist, hypot, pi, sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import outcome
from companion.core.formation.limits import FormationLimits
from companion.core.formation.slots import AGREED_WITHIN_S, WAITS_S, SlotPlan
from companion.geometry.curves import Motion, circle, duration_s, rest_to_rest, waypoint_path
from companion.geometry.formations import SHAPES, closest_approach, peak_speed_m_s, slots_of, smallest_distance
from companion.ground.changes import assign_slots
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot, FormationChange
from companion.types.notices import Answer, Code, Notice, accept
from companion.types.peers import LeaderReport, PeerPacket, Sender
from companion.types.peers import Motion as PeerMotion
from companion.types.values import ZERO3, Vector3

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
            assert smallest_distance(slots) == pytest.approx(3.0)
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
    assert {round(z, 6) for _, _, z in slots_of(SHAPES["layers"], 8, 2.0, 0.0)} == {0.0, 2.828427}


def test_no_slot_of_layers_is_directly_below_another() -> None:
    for n in SIZES:
        ground = [(round(x, 6), round(y, 6)) for x, y, _ in slots_of(SHAPES["layers"], n, 2.0, 0.0)]
        assert len(set(ground)) == n


# ---------------------------------------------------------------- paths


@pytest.mark.parametrize("n", [2, 4, 8, 13])
def test_assigned_paths_keep_1_over_sqrt_2_of_the_spacing_between_any_two_shapes(n: int) -> None:
    for before in SHAPES:
        start = dict(enumerate(slots_of(SHAPES[before], n, 3.0, 0.0)))
        for after in SHAPES:
            goal = assign_slots(start, slots_of(SHAPES[after], n, 3.0, 0.4))
            assert sorted(goal.values()) == sorted(slots_of(SHAPES[after], n, 3.0, 0.4))
            assert closest_approach(start, goal)[0] >= 3.0 / sqrt(2.0) - 1e-9, (before, after)


coordinates = st.floats(-20, 20)
points = st.tuples(coordinates, coordinates, coordinates)


@given(points, points, points, points)
def test_the_closest_approach_is_that_of_the_paths_flown(a0: Vector3, a1: Vector3, b0: Vector3, b1: Vector3) -> None:
    least_m, i, j = closest_approach({1: a0, 2: b0}, {1: a1, 2: b1})
    flown_m = [
        dist(rest_to_rest(a0, a1, t, 10.0)[0], rest_to_rest(b0, b1, t, 10.0)[0])
        for t in np.linspace(0, 10, 400).tolist()
    ]
    assert (i, j) == (1, 2)
    assert least_m <= min(flown_m) + 1e-9
    assert min(flown_m) <= least_m + 0.5  # between two samples


def test_a_path_is_as_fast_as_its_limits_allow() -> None:
    for path_m in (0.5, 10.0):
        lasts_s = duration_s(path_m, 2.0, 1.0)
        motions = [rest_to_rest(ZERO3, (path_m, 0.0, 0.0), t, lasts_s) for t in np.linspace(0, lasts_s, 2001).tolist()]
        speed, acceleration = (max(abs(m[k][0]) for m in motions) for k in (1, 2))
        assert speed <= 2.0 + 1e-6
        assert acceleration <= 1.0 + 1e-6
        assert max(speed / 2.0, acceleration) == pytest.approx(1.0, abs=1e-3)
        assert peak_speed_m_s({1: ZERO3}, {1: (path_m, 0.0, 0.0)}, lasts_s) == pytest.approx(speed, rel=1e-4)


@pytest.mark.parametrize(
    "curve",
    [
        lambda t: circle(t, 5.0, 20.0, 4.0),
        lambda t: circle(t, 5.0, -20.0, 4.0),
        waypoint_path([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 5.0, 2.0)], 1.0, 2.0, 1.0),
    ],
)
def test_velocity_and_acceleration_are_the_derivatives(curve: Callable[[float], Motion]) -> None:
    step_s = 1e-5
    for t in np.arange(0.01, 40.0, 0.05).tolist():
        (_, _, _), velocity, acceleration = curve(t)
        before, after = curve(t - step_s), curve(t + step_s)
        assert (np.subtract(after[0], before[0]) / (2 * step_s)) == pytest.approx(np.array(velocity), abs=1e-5)
        assert (np.subtract(after[1], before[1]) / (2 * step_s)) == pytest.approx(np.array(acceleration), abs=1e-3)


def test_a_waypoint_path_waits_at_its_points_and_stays_at_the_last() -> None:
    curve = waypoint_path([(0.0, 0.0, 0.0), (10.0, 0.0, 0.0), (10.0, 5.0, 0.0)], 3.0, 2.0, 1.0)
    leg_s = duration_s(10.0, 2.0, 1.0)
    for t in (leg_s, leg_s + 2.9):
        assert curve(t) == ((10.0, 0.0, 0.0), ZERO3, ZERO3)
    assert curve(1e6) == ((10.0, 5.0, 0.0), ZERO3, ZERO3)
    assert curve(-1.0) == (ZERO3, ZERO3, ZERO3)


# ---------------------------------------------------------------- slot plan of one vehicle


def plan(own_id: int = 2) -> SlotPlan:
    return SlotPlan(own_id, LINE, FormationLimits(1.0, 1.0, FENCE))


def flown(slots: SlotPlan, reference_s: float, others: Collection[PeerPacket], in_formation: bool) -> FlownSlot:
    slots.update(0.0, reference_s, others, in_formation)
    return slots.flown


def other(vehicle_id: int, formation: int, waiting: int) -> PeerPacket:
    slot = FlownSlot(LINE[vehicle_id], formation=formation, waiting=waiting)
    phase = FlightPhase.FORMATION
    return PeerPacket(
        sender=Sender(vehicle_id=vehicle_id, session=1, sequence=1, formation_hash=0),
        phase=phase,
        role=Role.FOLLOWER,
        motion=PeerMotion(
            position_enu_m=ZERO3, velocity_enu_m_s=ZERO3, acceleration_enu_m_s2=ZERO3, state_age_s=0.0, sent_s=0.0
        ),
        leader=LeaderReport(prc=2, beacon=None),
        slot=slot,
    )


KNOW = [other(1, 0, 1), other(3, 0, 1)]


def test_a_change_begins_at_its_time_when_all_peers_hold_it() -> None:
    slots = plan()
    assert slots.judge(CHANGE, 9.0, (), ()).carried_out() == accept(
        Code.FORMATION_ACCEPTED, "formation 1 begins in 1.0 s"
    )
    assert flown(slots, 9.9, KNOW, in_formation=True) == FlownSlot(LINE[2], formation=0, waiting=1)
    assert slots.update(0.0, 10.0, KNOW, in_formation=True) == (Notice(Code.FORMATION_CHANGED, "formation 0 -> 1"),)
    assert slots.flown == FlownSlot(LINE[2], formation=1, waiting=1)
    half_way = flown(slots, 20.0, KNOW, in_formation=True)
    assert half_way.position_enu_m == pytest.approx((-1.0, -1.0, 0.0))
    assert half_way.velocity_enu_m_s == pytest.approx((1.875 * 2.0 / 20.0, -1.875 * 2.0 / 20.0, 0.0))
    assert flown(slots, 30.0, KNOW, in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def flown_until(slots: SlotPlan, from_s: float, until_s: float, others: Collection[PeerPacket]) -> list[Code]:
    """Codes of the events, tick by tick of mission time."""
    ticks = range(round(from_s * 50), round(until_s * 50))
    return [event.code for tick in ticks for event in slots.update(0.0, tick / 50, others, in_formation=True)]


def test_slots_wait_while_a_vehicle_that_moves_with_them_is_silent() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    flown_until(slots, 9.0, 20.0, KNOW)
    assert flown_until(slots, 20.0, 22.0, KNOW[:1]) == [Code.FORMATION_WAITS]
    waiting = slots.flown
    assert waiting.velocity_enu_m_s == ZERO3
    assert waiting.position_enu_m != LINE[2] and waiting.position_enu_m != TURNED[2]
    assert not slots.is_settled(31.0)
    flown_until(slots, 22.0, 26.0, KNOW)
    assert slots.flown.velocity_enu_m_s != ZERO3
    flown_until(slots, 26.0, 33.0, KNOW)
    assert slots.flown == FlownSlot(TURNED[2], formation=1, waiting=1)
    assert slots.is_settled(33.0)


def test_slots_wait_for_a_silent_vehicle_no_longer_than_for_its_hand_over() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    flown_until(slots, 9.0, 20.0, KNOW)
    flown_until(slots, 20.0, 31.5 + WAITS_S, KNOW[:1])
    assert slots.flown == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_slots_do_not_wait_for_a_vehicle_that_left_formation() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    flown_until(slots, 9.0, 20.0, KNOW)
    flown_until(slots, 20.0, 21.0, [KNOW[0], replace(KNOW[1], phase=FlightPhase.HOLD)])
    assert flown_until(slots, 21.0, 31.0, KNOW[:1]) == []
    assert slots.flown == FlownSlot(TURNED[2], formation=1, waiting=1)


@pytest.mark.parametrize("on_ground", [True, False])
def test_a_command_replaces_a_formation_whose_number_was_too_far_ahead(on_ground: bool) -> None:
    """What another vehicle passes on must be newer; with a command the operator knows the numbers of all vehicles."""
    slots = plan()
    for number in (1000, 1001):
        assert slots.judge_on_ground(replace(CHANGE, number=number), (), ()).carried_out()[0]

    def change(new: FormationChange, **more: bool) -> Answer:
        judged = slots.judge_on_ground(new, (), (), **more) if on_ground else slots.judge(new, 9.0, (), (), **more)
        return judged.carried_out()

    assert outcome(change(CHANGE)) == (False, Code.CHANGE_TOO_OLD)
    assert outcome(change(replace(CHANGE, number=1001, lasts_s=9.0), is_command=True)) == (False, Code.CHANGE_TOO_OLD)
    assert change(CHANGE, is_command=True)[0]
    assert slots.update(0.0, 10.0, KNOW, in_formation=False) or on_ground
    assert flown(slots, 10.0, KNOW, in_formation=False).formation == 1


def test_a_change_is_cancelled_when_a_fresh_peer_lacks_it() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    text = "formation 1 does not begin: vehicle 3 does not have it"
    events = slots.update(0.0, 10.0, [KNOW[0], other(3, 0, 0)], in_formation=True)
    assert events == (Notice(Code.FORMATION_CANCELLED, text),)
    assert slots.flown == FlownSlot(LINE[2])
    assert flown(slots, 20.0, KNOW, in_formation=True) == FlownSlot(LINE[2])


def test_a_peer_that_began_a_tick_earlier_holds_the_change() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    assert flown(slots, 10.0, [other(1, 1, 1), other(3, 0, 1)], in_formation=True).formation == 1


def test_the_same_change_is_accepted_again() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    assert slots.judge(CHANGE, 9.5, (), ()).carried_out()[0]
    slots.update(0.0, 10.0, KNOW, in_formation=True)
    assert slots.judge(CHANGE, 12.0, (), ()).carried_out()[0]


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"number": 0}, "number 0 is not newer than 0"),
        ({"number": 5000}, "number 5000 is too far ahead of 0"),
        ({"slots_enu_m": CHANGE.slots_enu_m[:2]}, "slots for vehicles [1, 2]; expected [1, 2, 3]"),
        ({"slots_enu_m": (*CHANGE.slots_enu_m, (3, ZERO3))}, "slots for vehicles [1, 2, 3, 3]; expected [1, 2, 3]"),
        ({"slots_enu_m": ((1, ZERO3), (2, (-0.5, 0.0, 0.0)), (3, LINE[3]))}, "come within 0.50 m of each other"),
        ({"slots_enu_m": ((1, ZERO3), (2, (float("nan"), 0.0, 0.0)), (3, LINE[3]))}, "come within nan m"),
        ({"lasts_s": 5.0}, "slots move at up to 2.1 m/s; expected at most 1 m/s"),
        ({"lasts_s": float("nan")}, "lasts nan s"),
        ({"lasts_s": 0.0}, "lasts 0.0 s"),
        ({"slots_enu_m": tuple(LINE.items()), "lasts_s": 1e-200}, "lasts 0.0 s; expected 0.1 to 600 s"),
        ({"begins_s": 8.9}, "begins at mission time 8.9 s, which is 9.0 s now"),
        ({"begins_s": 100.0}, "begins at mission time 100.0 s"),
    ],
)
def test_a_change_that_cannot_be_flown_is_refused(changes: dict[str, object], text: str) -> None:
    slots = plan()
    ok, notice = slots.judge(replace(CHANGE, **changes), 9.0, (), ()).carried_out()
    assert not ok
    assert text in notice.text
    assert flown(slots, 50.0, KNOW, in_formation=True) == FlownSlot(LINE[2])


def test_a_change_begins_late_enough_for_all_to_know_who_has_accepted_it() -> None:
    too_late_s = CHANGE.begins_s - AGREED_WITHIN_S + 0.01
    assert outcome(plan().judge(CHANGE, too_late_s, (), ()).carried_out()) == (False, Code.CHANGE_NOT_IN_TIME)
    assert plan().judge(CHANGE, too_late_s - 0.02, (), ()).carried_out()[0]


def test_a_change_is_refused_while_another_is_flown() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    slots.update(0.0, 10.0, KNOW, in_formation=True)
    back = FormationChange(2, tuple(LINE.items()), 21.0, 20.0)
    assert outcome(slots.judge(back, 20.0, (), ()).carried_out()) == (False, Code.CHANGE_IN_PROGRESS)
    slots.update(0.0, 30.0, KNOW, in_formation=True)
    assert slots.judge(replace(back, begins_s=31.0), 30.0, (), ()).carried_out()[0]


def test_a_vehicle_outside_formation_adopts_the_formation_of_the_others_at_once() -> None:
    slots = plan()
    assert outcome(slots.judge(CHANGE, 40.0, [other(1, 1, 1)], ()).carried_out()) == (True, Code.FORMATION_ACCEPTED)
    assert flown(slots, 40.0, (), in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_a_change_whose_paths_cross_is_accepted_with_a_warning() -> None:
    exchange = replace(CHANGE, slots_enu_m=((1, LINE[2]), (2, LINE[1]), (3, LINE[3])))
    ok, notice = plan().judge(exchange, 9.0, (), ()).carried_out()
    assert (ok, notice.code) == (True, Code.FORMATION_ACCEPTED)
    assert "paths of vehicles 1 and 2 come within 0.00 m" in notice.text


FAR = {i: (x + 9000.0, y, z) for i, (x, y, z) in TURNED.items()}
WIDE = {**TURNED, 3: (0.0, -41.0, 0.0)}
CLOSE = {**TURNED, 3: (0.0, -2.5, 0.0)}


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"absent": (1, 2, 3)}, Code.SLOTS_INCOMPLETE),
        ({"absent": (4,)}, Code.SLOTS_INCOMPLETE),
        ({"slots_enu_m": tuple(FAR.items())}, Code.SLOT_OUTSIDE_FENCE),
        ({"slots_enu_m": tuple(WIDE.items())}, Code.SLOT_OUTSIDE_FENCE),
        ({"slots_enu_m": tuple(CLOSE.items())}, Code.SLOT_TOO_CLOSE),
    ],
)
def test_every_way_to_a_change_refuses_impossible_slots(changes: dict[str, object], code: Code) -> None:
    change, flying = replace(CHANGE, **changes), [other(1, 1, 1)]
    for answer in (
        plan().judge(change, 9.0, (), ()).carried_out(),
        plan().judge(change, 40.0, flying, ()).carried_out(),
        plan().judge_on_ground(change, (), ()).carried_out(),
        plan().judge_on_ground(change, flying, ()).carried_out(),
    ):
        assert outcome(answer) == (False, code)


def test_an_adopted_formation_is_settled_at_once() -> None:
    slots = plan()
    assert slots.judge(replace(CHANGE, begins_s=1e6, lasts_s=600.0), 40.0, [other(1, 1, 1)], ()).carried_out()[0]
    assert slots.is_settled(40.0)


def test_the_formation_stays_when_mission_time_restarts_after_landing() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    slots.update(0.0, 10.0, KNOW, in_formation=True)
    slots.restart()
    assert flown(slots, 0.0, (), in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_the_formation_stays_when_a_leader_restarts_mission_time_in_flight() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    slots.update(0.0, 10.0, KNOW, in_formation=True)
    assert flown(slots, 40.0, KNOW, in_formation=True).position_enu_m == TURNED[2]
    assert flown(slots, 39.9, KNOW, in_formation=True).position_enu_m == TURNED[2]
    for reference_s in (0.5, 9.0, 11.0, 15.0):
        assert flown(slots, reference_s, KNOW, in_formation=True) == FlownSlot(TURNED[2], formation=1, waiting=1)


def test_a_waiting_change_is_cancelled_when_the_vehicle_lands() -> None:
    slots = plan()
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    text = "formation 1 does not begin: the mission time restarts"
    assert slots.restart() == (Notice(Code.FORMATION_CANCELLED, text),)
    assert flown(slots, 30.0, KNOW, in_formation=True) == FlownSlot(LINE[2])
    assert slots.restart() == ()


def test_a_change_applies_at_once_on_the_ground() -> None:
    for own_id in (1, 2, 3):
        slots = plan(own_id)
        assert outcome(slots.judge_on_ground(CHANGE, (), ()).carried_out()) == (True, Code.FORMATION_ACCEPTED)
        assert flown(slots, 0.0, (), in_formation=True) == FlownSlot(TURNED[own_id], formation=1, waiting=1)
        assert flown(slots, 11.0, (), in_formation=True) == FlownSlot(
            TURNED[own_id], formation=1, waiting=1
        )  # nor in the next flight


def test_only_the_separation_of_slots_is_checked_on_the_ground() -> None:
    swapped = replace(CHANGE, slots_enu_m=((1, LINE[2]), (2, LINE[1]), (3, LINE[3])))
    assert plan().judge_on_ground(swapped, (), ()).carried_out()[0]
    near = replace(CHANGE, slots_enu_m=((1, ZERO3), (2, (-0.5, 0.0, 0.0)), (3, LINE[3])))
    assert plan().judge_on_ground(near, (), ()).carried_out().notice.code is Code.SLOT_TOO_CLOSE


def test_a_vehicle_on_the_ground_adopts_a_change_when_the_others_fly_it() -> None:
    slots = plan()
    text = "formation 1 is adopted here when the others fly it"
    assert slots.judge_on_ground(CHANGE, KNOW, ()).carried_out() == accept(Code.FORMATION_ACCEPTED, text)
    assert flown(slots, 0.0, KNOW, in_formation=True) == FlownSlot(LINE[2])
    assert outcome(slots.judge_on_ground(CHANGE, [other(1, 1, 1)], ()).carried_out()) == (True, Code.FORMATION_ACCEPTED)
    assert flown(slots, 0.0, KNOW, in_formation=True).position_enu_m == TURNED[2]


def test_an_older_formation_is_adopted_when_the_others_fly_it() -> None:
    slots = plan()
    assert slots.judge_on_ground(replace(CHANGE, number=7), (), ()).carried_out()[0]
    assert slots.judge(CHANGE, 40.0, [other(1, 1, 1)], ()).carried_out()[0]
    assert flown(slots, 40.0, (), in_formation=True).formation == 1


@pytest.mark.parametrize(
    ("rft_enu_m", "text"),
    [
        ((0.0, -17.0, 5.0), "puts vehicle 3 at y = -21.0 m, outside the fence less clearance_m (-20 to 20)"),
        ((0.0, 0.0, -0.1), "puts vehicle 1 at z = -0.1 m, outside the fence less clearance_m (0 to 20)"),
    ],
)
def test_a_change_is_refused_when_a_slot_leaves_the_fence(rft_enu_m: Vector3, text: str) -> None:
    inside = (0.0, 0.0, 5.0)
    assert plan().judge(CHANGE, 9.0, (), [inside]).carried_out()[0]
    for refused in (
        plan().judge(CHANGE, 9.0, (), [inside, rft_enu_m]).carried_out(),
        plan().judge_on_ground(CHANGE, (), [rft_enu_m]).carried_out(),
    ):
        assert outcome(refused) == (False, Code.SLOT_OUTSIDE_FENCE)
        assert text in refused.notice.text


def test_a_leader_passes_on_the_formation_flown_while_a_peer_lacks_it() -> None:
    slots = plan(1)
    assert slots.to_pass_on([other(2, 0, 0)]) is None
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    assert slots.to_pass_on(KNOW) == CHANGE
    slots.update(0.0, 10.0, KNOW, in_formation=True)
    assert slots.to_pass_on([other(2, 1, 1), other(3, 0, 1)]) is None
    assert slots.to_pass_on([other(2, 1, 1), other(3, 0, 0)]) == CHANGE
    assert slots.to_pass_on([other(2, 2, 2)]) == CHANGE  # a change that was cancelled


@pytest.mark.parametrize("number", [2, 1000])
def test_the_first_leader_replaces_a_waiting_change_of_any_number(number: int) -> None:
    """One packet in the leader's name stopped all of its changes for a minute."""
    slots, wrong = plan(), replace(CHANGE, number=number, begins_s=60.0)
    assert slots.judge(wrong, 9.0, (), ()).carried_out()[0]
    assert not slots.lacks(CHANGE, over_own=False)
    assert slots.lacks(CHANGE, over_own=True)
    assert slots.judge(CHANGE, 9.0, (), ()).carried_out()[0]
    assert flown(slots, 10.0, KNOW, in_formation=True).formation == 1
    assert not slots.lacks(CHANGE, over_own=True)  # flown: the leader sends it while a peer lacks it


def test_the_change_of_the_first_leader_wins_when_two_have_one_number() -> None:
    slots, same_number = plan(), replace(CHANGE, begins_s=11.0)
    assert slots.lacks(CHANGE, over_own=False)
    slots.judge(CHANGE, 9.0, (), ()).carried_out()
    assert not slots.lacks(CHANGE, over_own=True)
    assert slots.lacks(same_number, over_own=True)
    assert not slots.lacks(same_number, over_own=False)
    assert slots.lacks(replace(CHANGE, number=2), over_own=False)
    assert slots.judge(same_number, 9.0, (), ()).carried_out()[0]
    assert flown(slots, 10.5, KNOW, in_formation=True).formation == 0
    assert flown(slots, 11.0, KNOW, in_formation=True).formation == 1
    assert not slots.lacks(same_number, over_own=True)
