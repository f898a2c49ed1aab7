"""Where a formation points: slots that turn, the limits of turning, and who says it."""

from __future__ import annotations

from dataclasses import replace as changed
from itertools import pairwise
from math import cos, degrees, hypot, pi, remainder, sin, tau
from pathlib import Path

import pytest
from cooperating_fleet import RING, Fleet
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from companion.config.fleet import FleetConfig, load_fleet
from companion.config.reference import CircleReference, PointReference, Reference, check_reference, most_pace
from companion.config_file import ConfigError
from companion.core.cooperation import Neighbourhood
from companion.core.formation import Place
from companion.core.formation_limits import FormationLimits
from companion.core.hand_over import HandOverLimits
from companion.core.heading import JERK_1_S, SLOWEST_M_S, CourseHeading, FixedHeading, turned_towards
from companion.core.reference_clock import WAITED_S
from companion.geometry.turning import (
    SLOT_ACCELERATION_M_S2,
    TurnLimits,
    course,
    heading_after,
    reach_m,
    swept,
    turn_limits,
    turned_slot,
)
from companion.types import EAST, ZERO3, FlightPhase, FlownSlot, Heading, HealthFlag, Lead, Role, Vector3

TICK_S = 0.02
LIMITS = TurnLimits(0.3, 0.2)
PAIR = Path(__file__).parents[2] / "config" / "fleets" / "pair.yaml"
coordinates = st.floats(-20, 20)
vectors = st.tuples(coordinates, coordinates, coordinates)
rates = st.floats(-1, 1)


# ---------------------------------------------------------------- slots that turn


@given(vectors, vectors, vectors, st.builds(Heading, st.floats(-pi, pi), rates, rates))
def test_velocity_and_acceleration_of_a_turned_slot_are_its_derivatives(
    d: Vector3, v: Vector3, a: Vector3, heading: Heading
) -> None:
    def at(t: float) -> FlownSlot:
        moved = tuple(x + dx * t + ddx * t * t / 2.0 for x, dx, ddx in zip(d, v, a, strict=True))
        faster = tuple(dx + ddx * t for dx, ddx in zip(v, a, strict=True))
        return turned_slot(FlownSlot(moved, faster, a, 3, 4), heading_after(heading, t))  # type: ignore[arg-type]

    step_s = 1e-4
    before, now, after = at(-step_s), at(0.0), at(step_s)
    for k in range(3):
        moves = (after.position_enu_m[k] - before.position_enu_m[k]) / (2 * step_s)
        assert moves == pytest.approx(now.velocity_enu_m_s[k], abs=1e-4)
        gains = (after.velocity_enu_m_s[k] - before.velocity_enu_m_s[k]) / (2 * step_s)
        assert gains == pytest.approx(now.acceleration_enu_m_s2[k], abs=1e-4)
    assert (now.formation, now.waiting) == (3, 4)


def test_a_formation_to_the_east_is_as_its_slots_are_given() -> None:
    slot = FlownSlot((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    assert turned_slot(slot, EAST) is slot
    north = turned_slot(slot, Heading(pi / 2.0))
    assert north.position_enu_m == pytest.approx((-2.0, 1.0, 3.0))
    assert north.velocity_enu_m_s == pytest.approx((-0.2, 0.1, 0.3))


@pytest.mark.parametrize("reach", [0.5, 2.0, 6.0, 50.0])
@pytest.mark.parametrize("speed_m_s", [0.5, 1.0, 5.0])
def test_the_outermost_slot_keeps_its_speed_and_acceleration(reach: float, speed_m_s: float) -> None:
    limits = turn_limits(reach, speed_m_s)
    slot = turned_slot(FlownSlot((reach, 0.0, 0.0)), Heading(1.0, limits.rate_rad_s, limits.acceleration_rad_s2))
    assert hypot(*slot.velocity_enu_m_s) <= speed_m_s + 1e-9
    assert hypot(*slot.acceleration_enu_m_s2) <= SLOT_ACCELERATION_M_S2 + 1e-9


def test_all_slots_at_the_reference_turn_no_faster_than_is_sensible() -> None:
    assert turn_limits(reach_m([(0.0, 0.0, 5.0)]), 5.0) == turn_limits(0.01, 5.0) == TurnLimits(1.0, 1.0)


def test_slots_that_turn_need_room_all_round() -> None:
    fence = ((-10.0, -10.0, 0.0), (10.0, 10.0, 5.0))
    hand_over = HandOverLimits(1.0, 1.0, 1.0, 1.0, fence, slots_turn=True)
    assert swept([(3.0, 4.0, 1.0)]) == [(-5.0, -5.0, 1.0), (5.0, 5.0, 1.0)]
    assert hand_over.room([(3.0, 4.0, 1.0), (0.0, 0.0, 0.0)]) == ((-5.0, -5.0, 0.0), (5.0, 5.0, 4.0))
    assert changed(hand_over, slots_turn=False).room([(3.0, 4.0, 1.0)]) == ((-13.0, -14.0, -1.0), (7.0, 6.0, 4.0))

    slots: dict[int, Vector3] = {1: ZERO3, 2: (3.0, 4.0, 1.0)}
    limits = FormationLimits(1.0, 1.0, fence, slots_turn=True)
    assert limits.refusal_of_places(slots, [(5.0, 0.0, 2.0)]) is None
    assert limits.refusal_of_places(slots, [(-6.0, 0.0, 2.0)]) == (
        "puts vehicle 2 at x = -11.0 m, outside the fence (-10 to 10)"
    )
    assert changed(limits, slots_turn=False).refusal_of_places(slots, [(-6.0, 0.0, 2.0)]) is None


# ---------------------------------------------------------------- turning


@given(st.floats(-pi, pi), st.floats(-0.25, 0.25), st.floats(-pi, pi), st.floats(-0.3, 0.3))
def test_whatever_its_goal_it_turns_within_its_limits_and_comes_there(
    angle_rad: float, goal_rate_rad_s: float, goal_rad: float, rate_rad_s: float
) -> None:
    now, goal = Heading(angle_rad, rate_rad_s), Heading(goal_rad, goal_rate_rad_s)
    way = [now]
    for _ in range(round(60.0 / TICK_S)):
        goal = heading_after(goal, TICK_S)
        now = turned_towards(now, goal, LIMITS, TICK_S)
        way.append(now)
    assert max(abs(h.rate_rad_s) for h in way) <= 1.05 * LIMITS.rate_rad_s
    assert max(abs(h.acceleration_rad_s2) for h in way) <= LIMITS.acceleration_rad_s2 + 1e-9
    steps = [abs(b.acceleration_rad_s2 - a.acceleration_rad_s2) for a, b in pairwise(way)]
    assert max(steps) <= JERK_1_S * LIMITS.acceleration_rad_s2 * TICK_S + 1e-9
    assert all(abs(h.angle_rad) <= pi for h in way)
    assert remainder(now.angle_rad - goal.angle_rad, tau) == pytest.approx(0.0, abs=2e-3)
    assert now.rate_rad_s == pytest.approx(goal.rate_rad_s, abs=2e-3)


@pytest.mark.parametrize("way_round", [1.0, -1.0])
def test_what_turns_already_goes_on_that_way_to_a_goal_behind_it(way_round: float) -> None:
    now = Heading(0.0, way_round * 0.2)
    for behind_rad in (pi - 0.05, -pi + 0.05):
        assert turned_towards(now, Heading(behind_rad), LIMITS, TICK_S).acceleration_rad_s2 * way_round > 0.0


def test_no_time_turns_nothing() -> None:
    assert turned_towards(Heading(1.0, 0.1, 0.1), EAST, LIMITS, 0.0) == Heading(1.0, 0.1, 0.1)


def test_the_course_of_a_circle_turns_with_it_and_what_stands_has_none() -> None:
    found = course((0.0, 2.0, 1.0), (-1.0, 0.0, 0.0), SLOWEST_M_S)
    assert found is not None
    assert found.angle_rad == pytest.approx(pi / 2.0)
    assert found.rate_rad_s == pytest.approx(0.5)
    assert course((0.0, SLOWEST_M_S, 9.0), (1.0, 0.0, 0.0), SLOWEST_M_S) is None


# ---------------------------------------------------------------- who says it

NOBODY = Neighbourhood(Role.LEADER, 0, 1.0, 1, None, 0.0, None, (), (), (), None)
REACH_M = 3.0


def hearing(heading: Heading | None, leaderless: HealthFlag | None = None) -> Neighbourhood:
    return replace(NOBODY, role=Role.FOLLOWER, heading=heading, leaderless=leaderless)


def northwards(speed_m_s: float = 2.0) -> Place:
    return Place(ZERO3, (0.0, speed_m_s, 0.0))


def led(heading: CourseHeading, seconds: float, led_by: Place | None, from_s: float) -> float:
    """When it is then."""
    now_s = from_s
    for _ in range(round(seconds / TICK_S)):
        now_s += TICK_S
        heading.update(now_s, NOBODY, led_by, REACH_M)
    return now_s


def test_who_leads_turns_to_the_course_and_keeps_the_last_one_at_rest() -> None:
    heading = CourseHeading(1.0)
    now_s = led(heading, 1.0, northwards(speed_m_s=0.05), 100.0)
    assert heading.flown == EAST
    now_s = led(heading, 20.0, northwards(), now_s)
    assert heading.flown.angle_rad == pytest.approx(pi / 2.0, abs=1e-3)
    now_s = led(heading, 20.0, northwards(speed_m_s=0.05), now_s)
    led(heading, 20.0, None, now_s)
    assert heading.flown.angle_rad == pytest.approx(pi / 2.0, abs=1e-3)
    assert heading.told == heading.flown


def test_stopped_on_the_way_it_comes_to_rest_softly() -> None:
    heading = CourseHeading(1.0)
    now_s = led(heading, 3.0, northwards(), 100.0)
    before = heading.flown
    assert before.rate_rad_s > 0.1
    led(heading, TICK_S, None, now_s)
    step = abs(heading.flown.acceleration_rad_s2 - before.acceleration_rad_s2)
    assert step <= JERK_1_S * turn_limits(REACH_M, 1.0).acceleration_rad_s2 * TICK_S + 1e-9
    led(heading, 10.0, None, now_s)
    assert heading.flown.rate_rad_s == pytest.approx(0.0, abs=1e-3)


def test_who_follows_turns_as_it_hears_and_leads_on_from_there_without_a_step() -> None:
    heading, heard, now_s = CourseHeading(2.0), Heading(0.5, 0.2), 100.0
    for _ in range(200):
        now_s, heard = now_s + TICK_S, heading_after(heard, TICK_S)
        heading.update(now_s, hearing(heard), None, REACH_M)
    assert heading.told == heard
    assert heading.flown.angle_rad == pytest.approx(heard.angle_rad, abs=1e-3)
    before = heading.flown
    led(heading, TICK_S, northwards(), now_s)
    assert heading.flown.angle_rad == pytest.approx(heading_after(before, TICK_S).angle_rad, abs=1e-3)
    assert heading.flown.rate_rad_s == pytest.approx(before.rate_rad_s, abs=0.02)
    assert heading.told == heading.flown


def test_a_word_that_jumps_turns_nobody_in_a_step() -> None:
    heading = CourseHeading(1.0)
    heading.update(100.0, hearing(Heading(0.0)), None, REACH_M)
    heading.update(100.02, hearing(Heading(3.0, -5.0, 20.0)), None, REACH_M)
    assert abs(heading.flown.angle_rad) < 0.001
    assert abs(heading.flown.rate_rad_s) < 0.01


def test_while_a_leader_is_awaited_it_turns_on_and_without_one_it_comes_to_rest() -> None:
    heading = CourseHeading(1.0)
    heading.update(100.0, hearing(Heading(0.0, 0.2, 0.1)), None, REACH_M)
    awaited, lost = hearing(None, HealthFlag.LEADER_AWAITED), hearing(None, HealthFlag.LEADER_LOST)
    for tick in range(1, 26):
        heading.update(100.0 + tick * TICK_S, awaited, None, REACH_M)
    assert heading.flown.angle_rad == pytest.approx(0.1)
    assert heading.flown.rate_rad_s == pytest.approx(0.2)
    for tick in range(26, 500):
        heading.update(100.0 + tick * TICK_S, lost, None, REACH_M)
    assert heading.flown.rate_rad_s == pytest.approx(0.0, abs=1e-3)


def test_after_a_landing_it_begins_anew_or_as_the_others_fly() -> None:
    heading = CourseHeading(1.0)
    led(heading, 20.0, northwards(), 100.0)
    heading.begin_anew()
    heading.update(200.0, NOBODY, None, REACH_M)
    assert heading.flown == EAST
    heading.begin_anew()
    heading.update(300.0, hearing(Heading(1.5, 0.1)), None, REACH_M)
    assert heading.flown == Heading(1.5, 0.1)


def test_a_fixed_formation_turns_for_nobody() -> None:
    heading = FixedHeading()
    heading.update(100.0, hearing(Heading(1.0, 1.0, 1.0)), northwards(), REACH_M)
    heading.begin_anew()
    assert heading.flown == heading.told == EAST


def heard_in(fleet: Fleet, vehicle_id: int, told: dict[int, Heading]) -> Heading | None:
    """What a vehicle of a fleet hears when its leaders have told this."""
    for _ in range(10):
        fleet.tick()
        fleet.packets = {
            i: replace(
                p, leader_word=p.leader_word and replace(p.leader_word, heading=told.get(p.leader_word.leader_id, EAST))
            )
            for i, p in fleet.packets.items()
        }
    return fleet.tick()[vehicle_id].heading


def test_a_heading_is_heard_of_the_leader_and_carried_on_over_its_age() -> None:
    told = Heading(1.0, 0.5)
    fleet = Fleet(RING, (1, 2))
    assert heard_in(fleet, 1, {1: told}) is None
    assert heard_in(fleet, 2, {1: told}) == heading_after(told, WAITED_S)


def test_what_is_passed_on_stays_believable() -> None:
    fleet = Fleet(RING, (1, 2))
    assert heard_in(fleet, 2, {1: Heading(0.0, 5.0, 20.0)}) == replace(
        heading_after(Heading(0.0, 5.0, 20.0), WAITED_S), rate_rad_s=5.0
    )


def test_of_several_leaders_the_first_by_id_says_it() -> None:
    fleet = Fleet(RING, (1, 2))
    fleet.give(Lead((1, 2), 1))
    told = {1: Heading(1.0), 2: Heading(2.0)}
    assert heard_in(fleet, 1, told) is None
    assert heard_in(fleet, 2, told) == Heading(1.0)


def test_who_leads_and_is_not_in_formation_heeds_one_that_flies() -> None:
    fleet = Fleet(RING, (1, 2))
    fleet.give(Lead((1, 2), 1))
    fleet.phases[1] = FlightPhase.HOLD
    assert heard_in(fleet, 1, {2: Heading(2.0)}) == Heading(2.0)


# ---------------------------------------------------------------- files


def turning(**changes: object) -> FleetConfig:
    return replace(load_fleet(PAIR), formation_heading="course", **changes)  # type: ignore[arg-type]


def refusal(fleet: FleetConfig, reference: Reference) -> str:
    with pytest.raises(ConfigError) as caught:
        check_reference(Path("v.yaml"), fleet, reference, slots_enu_m={1: ZERO3, 2: (-3.0, 4.0, 0.0)})
    return str(caught.value)


def test_a_file_says_whether_the_formation_turns(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(PAIR.read_text() + "\nformation_heading: course\n")
    assert load_fleet(file).slots_turn
    assert not load_fleet(PAIR).slots_turn
    assert load_fleet(file).formation_hash() != load_fleet(PAIR).formation_hash()
    file.write_text(PAIR.read_text() + "\nformation_heading: north\n")
    with pytest.raises(ConfigError, match="formation_heading: 'north': expected one of course, fixed"):
        load_fleet(file)


def test_a_turning_formation_keeps_the_fence_whichever_way_it_points() -> None:
    fleet = turning()
    near = PointReference((fleet.envelope.fence_max_enu_m[0] - 4.5, 0.0, 3.0))  # fixed, no slot lies to the east of it
    assert "puts vehicle 2 at x = " in refusal(fleet, near)
    check_reference(
        Path("v.yaml"), load_fleet(PAIR), near, slots_enu_m={1: ZERO3, 2: (-3.0, 4.0, 0.0)}
    )  # raises nothing


def test_a_course_that_turns_faster_than_the_formation_can_is_refused_with_what_would_do() -> None:
    circle = CircleReference((0.0, 0.0, 3.0), 5.0, 20.0)  # 2 pi / 20 = 0.31 rad/s; 1 m/s at 5 m are 0.2
    words = refusal(turning(), circle)
    assert "v.yaml: reference.period_s: 20 s turns the course by up to 0.31 rad/s" in words
    assert "reaches 5.0 m can 0.20; expected at least 31.5 s" in words
    check_reference(Path("v.yaml"), turning(), replace(circle, period_s=31.5), slots_enu_m={2: (-3.0, 4.0, 0.0)})
    check_reference(Path("v.yaml"), turning(slot_speed_m_s=2.0), circle, slots_enu_m={2: (-3.0, 4.0, 0.0)})
    check_reference(Path("v.yaml"), load_fleet(PAIR), circle, slots_enu_m={2: (-3.0, 4.0, 0.0)})


def test_what_turning_takes_is_left_to_it_of_speed_and_tilt() -> None:
    speed_m_s, acceleration_m_s2 = most_pace(load_fleet(PAIR))
    less_speed_m_s, less_acceleration_m_s2 = most_pace(turning(slot_speed_m_s=2.0))
    assert less_speed_m_s == pytest.approx(speed_m_s - 2.0)
    assert less_acceleration_m_s2 == pytest.approx(acceleration_m_s2 - SLOT_ACCELERATION_M_S2)
    fast = CircleReference((0.0, 0.0, 3.0), 30.0, 12.0, ramp_s=30.0)
    assert "less what slots need that turn" not in refusal(load_fleet(PAIR), fast)
    assert "less what slots need that turn" in refusal(turning(), fast)


def test_degrees_are_counted_from_the_east() -> None:
    found = course((cos(2.0), sin(2.0), 0.0), ZERO3, SLOWEST_M_S)
    assert found is not None
    assert degrees(found.angle_rad) == pytest.approx(degrees(2.0))
