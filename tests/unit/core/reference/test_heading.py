"""Heading of a formation: rotated slots, limits of the rotation, source of the heading."""

from __future__ import annotations

from dataclasses import replace as changed
from itertools import pairwise
from math import cos, degrees, hypot, pi, remainder, sin, tau
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from msgspec.structs import replace

from common import ROOT, with_fields
from companion.config.file import ConfigError
from companion.config.fleet import FleetConfig
from companion.config.fleet_check import load_fleet
from companion.config.reference import CircleReference, PointReference, Reference
from companion.config.reference_check import check_reference, most_pace
from companion.core.consensus.stage import Consensus, LeadView, Neighbours, PeerSets
from companion.core.election.beacon import WAITED_S
from companion.core.formation.entry import FormationEntry, Joining, LeadIn
from companion.core.formation.guidance import GuidanceStage
from companion.core.formation.limits import FormationLimits
from companion.core.formation.paths import FormingTogether
from companion.core.formation.slots import SlotPlan
from companion.core.reference.blend import BlendLimits
from companion.core.reference.heading import JERK_1_S, SLOWEST_M_S, CourseHeading, turned_towards
from companion.geometry.formations import (
    SLOT_ACCELERATION_M_S2,
    TurnLimits,
    course,
    heading_after,
    reach_m,
    swept,
    turn_limits,
    turned_slot,
)
from companion.types.autopilot import VehicleState
from companion.types.commands import Lead
from companion.types.flight import Flight, FlightPhase, HealthFlag, Role
from companion.types.formation import EAST, FlownSlot, FormationState, Heading
from companion.types.notices import Code, Notice
from companion.types.values import ZERO3, Vector3
from stage_fleets import RING, CooperatingFleet

TICK_S = 0.02
LIMITS = TurnLimits(0.3, 0.2)
ACCELERATING_S = 15.0  # accelerations at both ends and the final settling, with a margin
PAIR = ROOT / "config" / "fleets" / "pair.yaml"
coordinates = st.floats(-20, 20)
vectors = st.tuples(coordinates, coordinates, coordinates)
rates = st.floats(-1, 1)


# ---------------------------------------------------------------- slots that turn


@given(vectors, vectors, vectors, st.builds(Heading, st.floats(-pi, pi), rates, rates))
def test_velocity_and_acceleration_of_a_rotated_slot_are_derivatives(
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


def test_heading_east_leaves_the_slots_unchanged() -> None:
    slot = FlownSlot((1.0, 2.0, 3.0), (0.1, 0.2, 0.3))
    assert turned_slot(slot, EAST) is slot
    north = turned_slot(slot, Heading(pi / 2.0))
    assert north.position_enu_m == pytest.approx((-2.0, 1.0, 3.0))
    assert north.velocity_enu_m_s == pytest.approx((-0.2, 0.1, 0.3))


@pytest.mark.parametrize("reach", [0.5, 2.0, 6.0, 50.0])
@pytest.mark.parametrize("speed_m_s", [0.5, 1.0, 5.0])
def test_outermost_slot_keeps_its_speed_and_acceleration_limits(reach: float, speed_m_s: float) -> None:
    limits = turn_limits(reach, speed_m_s)
    slot = turned_slot(FlownSlot((reach, 0.0, 0.0)), Heading(1.0, limits.rate_rad_s, limits.acceleration_rad_s2))
    assert hypot(*slot.velocity_enu_m_s) <= speed_m_s + 1e-9
    assert hypot(*slot.acceleration_enu_m_s2) <= SLOT_ACCELERATION_M_S2 + 1e-9


def test_rotation_rate_is_limited_for_slots_at_the_reference() -> None:
    assert turn_limits(reach_m([(0.0, 0.0, 5.0)]), 5.0) == turn_limits(0.01, 5.0) == TurnLimits(1.0, 1.0)


def test_rotating_slots_sweep_full_circles() -> None:
    fence = ((-10.0, -10.0, 0.0), (10.0, 10.0, 5.0))
    hand_over = BlendLimits(1.0, 1.0, 1.0, 1.0, fence, slots_turn=True)
    assert swept([(3.0, 4.0, 1.0)]) == [(-5.0, -5.0, 1.0), (5.0, 5.0, 1.0)]
    assert hand_over.box([(3.0, 4.0, 1.0), (0.0, 0.0, 0.0)]) == ((-5.0, -5.0, 0.0), (5.0, 5.0, 4.0))
    assert changed(hand_over, slots_turn=False).box([(3.0, 4.0, 1.0)]) == ((-13.0, -14.0, -1.0), (7.0, 6.0, 4.0))

    slots: dict[int, Vector3] = {1: ZERO3, 2: (3.0, 4.0, 1.0)}
    limits = FormationLimits(1.0, 1.0, fence, slots_turn=True)
    assert limits.refusal_of_positions(slots, [(5.0, 0.0, 2.0)]) is None
    assert limits.refusal_of_positions(slots, [(-6.0, 0.0, 2.0)]) == Notice(
        Code.SLOT_OUTSIDE_FENCE, "puts vehicle 2 at x = -11.0 m, outside the fence less clearance_m (-10 to 10)"
    )
    assert changed(limits, slots_turn=False).refusal_of_positions(slots, [(-6.0, 0.0, 2.0)]) is None


# ---------------------------------------------------------------- turning


@given(st.floats(-pi, pi), st.floats(-0.25, 0.25), st.floats(-pi, pi), st.floats(-0.3, 0.3))
@example(-2.5, 0.25, 0.5, 0.0)  # the goal turns away: the heading gains 0.05 rad/s on it
def test_heading_reaches_its_goal_in_the_expected_time(
    angle_rad: float, goal_rate_rad_s: float, goal_rad: float, rate_rad_s: float
) -> None:
    now, goal = Heading(angle_rad, rate_rad_s), Heading(goal_rad, goal_rate_rad_s)
    headings = [now]
    slowest_closing_rad_s = LIMITS.rate_rad_s - abs(goal_rate_rad_s)
    for _ in range(round((pi / slowest_closing_rad_s + ACCELERATING_S) / TICK_S)):
        goal = heading_after(goal, TICK_S)
        now = turned_towards(now, goal, LIMITS, TICK_S)
        headings.append(now)
    assert max(abs(h.rate_rad_s) for h in headings) <= 1.05 * LIMITS.rate_rad_s
    assert max(abs(h.acceleration_rad_s2) for h in headings) <= LIMITS.acceleration_rad_s2 + 1e-9
    steps = [abs(b.acceleration_rad_s2 - a.acceleration_rad_s2) for a, b in pairwise(headings)]
    assert max(steps) <= JERK_1_S * LIMITS.acceleration_rad_s2 * TICK_S + 1e-9
    assert all(abs(h.angle_rad) <= pi for h in headings)
    assert remainder(now.angle_rad - goal.angle_rad, tau) == pytest.approx(0.0, abs=2e-3)
    assert now.rate_rad_s == pytest.approx(goal.rate_rad_s, abs=2e-3)


@pytest.mark.parametrize("way_round", [1.0, -1.0])
def test_rotation_continues_in_its_direction_to_an_opposite_goal(way_round: float) -> None:
    now = Heading(0.0, way_round * 0.2)
    for behind_rad in (pi - 0.05, -pi + 0.05):
        assert turned_towards(now, Heading(behind_rad), LIMITS, TICK_S).acceleration_rad_s2 * way_round > 0.0


def test_heading_is_unchanged_after_zero_time() -> None:
    assert turned_towards(Heading(1.0, 0.1, 0.1), EAST, LIMITS, 0.0) == Heading(1.0, 0.1, 0.1)


def test_course_of_a_circle_and_of_a_point_at_rest() -> None:
    found = course((0.0, 2.0, 1.0), (-1.0, 0.0, 0.0), SLOWEST_M_S)
    assert found is not None
    assert found.angle_rad == pytest.approx(pi / 2.0)
    assert found.rate_rad_s == pytest.approx(0.5)
    assert course((0.0, SLOWEST_M_S, 9.0), (1.0, 0.0, 0.0), SLOWEST_M_S) is None


# ---------------------------------------------------------------- source of the heading

LEADER = Consensus(
    prc=1,
    lead=LeadView(Role.LEADER, (0, 0), None, 0.0, None, reference_s=1.0, heading=None),
    neighbours=Neighbours(),
    peers=PeerSets(),
)
REACH_M = 3.0


def receiving(heading: Heading | None, leaderless: HealthFlag | None = None) -> Consensus:
    lead = replace(LEADER.lead, role=Role.FOLLOWER, heading=heading, leaderless=leaderless)
    return replace(LEADER, lead=lead)


def northwards(speed_m_s: float = 2.0) -> FormationState:
    return FormationState(ZERO3, (0.0, speed_m_s, 0.0))


def led(heading: CourseHeading, seconds: float, reference: FormationState | None, from_s: float) -> float:
    """The time after it."""
    now_s = from_s
    for _ in range(round(seconds / TICK_S)):
        now_s += TICK_S
        heading.update(now_s, LEADER, reference, REACH_M)
    return now_s


def test_leader_turns_to_the_course_and_keeps_it_at_rest() -> None:
    heading = CourseHeading(1.0)
    now_s = led(heading, 1.0, northwards(speed_m_s=0.05), 100.0)
    assert heading.flown == EAST
    now_s = led(heading, 20.0, northwards(), now_s)
    assert heading.flown.angle_rad == pytest.approx(pi / 2.0, abs=1e-3)
    now_s = led(heading, 20.0, northwards(speed_m_s=0.05), now_s)
    led(heading, 20.0, None, now_s)
    assert heading.flown.angle_rad == pytest.approx(pi / 2.0, abs=1e-3)
    assert heading.published == heading.flown


def test_interrupted_rotation_stops_within_its_limits() -> None:
    heading = CourseHeading(1.0)
    now_s = led(heading, 3.0, northwards(), 100.0)
    before = heading.flown
    assert before.rate_rad_s > 0.1
    led(heading, TICK_S, None, now_s)
    step = abs(heading.flown.acceleration_rad_s2 - before.acceleration_rad_s2)
    assert step <= JERK_1_S * turn_limits(REACH_M, 1.0).acceleration_rad_s2 * TICK_S + 1e-9
    led(heading, 10.0, None, now_s)
    assert heading.flown.rate_rad_s == pytest.approx(0.0, abs=1e-3)


def test_follower_copies_the_heading_and_leads_on_without_a_step() -> None:
    heading, received, now_s = CourseHeading(2.0), Heading(0.5, 0.2), 100.0
    for _ in range(200):
        now_s, received = now_s + TICK_S, heading_after(received, TICK_S)
        heading.update(now_s, receiving(received), None, REACH_M)
    assert heading.published == received
    assert heading.flown.angle_rad == pytest.approx(received.angle_rad, abs=1e-3)
    before = heading.flown
    led(heading, TICK_S, northwards(), now_s)
    assert heading.flown.angle_rad == pytest.approx(heading_after(before, TICK_S).angle_rad, abs=1e-3)
    assert heading.flown.rate_rad_s == pytest.approx(before.rate_rad_s, abs=0.02)
    assert heading.published == heading.flown


def test_jump_of_the_published_heading_causes_no_step() -> None:
    heading = CourseHeading(1.0)
    heading.update(100.0, receiving(Heading(0.0)), None, REACH_M)
    heading.update(100.02, receiving(Heading(3.0, -5.0, 20.0)), None, REACH_M)
    assert abs(heading.flown.angle_rad) < 0.001
    assert abs(heading.flown.rate_rad_s) < 0.01


def test_rotation_continues_while_a_leader_is_awaited_and_stops_without_one() -> None:
    heading = CourseHeading(1.0)
    heading.update(100.0, receiving(Heading(0.0, 0.2, 0.1)), None, REACH_M)
    awaited, lost = receiving(None, HealthFlag.LEADER_AWAITED), receiving(None, HealthFlag.LEADER_LOST)
    for tick in range(1, 26):
        heading.update(100.0 + tick * TICK_S, awaited, None, REACH_M)
    assert heading.flown.angle_rad == pytest.approx(0.1)
    assert heading.flown.rate_rad_s == pytest.approx(0.2)
    for tick in range(26, 500):
        heading.update(100.0 + tick * TICK_S, lost, None, REACH_M)
    assert heading.flown.rate_rad_s == pytest.approx(0.0, abs=1e-3)


def test_heading_is_reset_after_a_landing() -> None:
    heading = CourseHeading(1.0)
    led(heading, 20.0, northwards(), 100.0)
    heading.restart()
    heading.update(200.0, LEADER, None, REACH_M)
    assert heading.flown == EAST
    heading.restart()
    heading.update(300.0, receiving(Heading(1.5, 0.1)), None, REACH_M)
    assert heading.flown == Heading(1.5, 0.1)


def test_fixed_formation_ignores_headings() -> None:
    slots_m = {1: ZERO3, 2: (-3.0, 4.0, 0.0)}
    slots = SlotPlan(2, slots_m, FormationLimits(1.0, 1.0, ((-50.0, -50.0, 0.0), (50.0, 50.0, 30.0))))
    entry = FormationEntry(2, FormingTogether(2, 1.0, 1.0, 1.0, True), Joining(2, 1.0, 1.0), LeadIn(1.0, 1.0))
    stage = GuidanceStage(2, slots, heading=None, references=None, entry=entry, gap_filling=None)
    flown = stage.step(100.0, VehicleState(armed=True), Flight(), receiving(Heading(1.0, 1.0, 1.0)), (), ())
    assert flown.heading == flown.published_heading == EAST
    assert flown.slot.position_enu_m == slots_m[2]


def received_heading(fleet: CooperatingFleet, vehicle_id: int, published: dict[int, Heading]) -> Heading | None:
    """Heading that a vehicle of a fleet receives for these published headings."""
    for _ in range(10):
        fleet.tick()
        fleet.packets = {
            i: with_fields(
                p,
                beacon=p.leader.beacon
                and replace(p.leader.beacon, heading=published.get(p.leader.beacon.leader_id, EAST)),
            )
            for i, p in fleet.packets.items()
        }
    return fleet.tick()[vehicle_id].lead.heading


def test_heading_of_the_leader_is_extrapolated_over_its_age() -> None:
    heading = Heading(1.0, 0.5)
    fleet = CooperatingFleet(RING, (1, 2))
    assert received_heading(fleet, 1, {1: heading}) is None
    assert received_heading(fleet, 2, {1: heading}) == heading_after(heading, WAITED_S)


def test_relayed_heading_stays_plausible() -> None:
    fleet = CooperatingFleet(RING, (1, 2))
    assert received_heading(fleet, 2, {1: Heading(0.0, 5.0, 20.0)}) == replace(
        heading_after(Heading(0.0, 5.0, 20.0), WAITED_S), rate_rad_s=5.0
    )


def test_heading_is_of_the_leader_with_the_lowest_id() -> None:
    fleet = CooperatingFleet(RING, (1, 2))
    fleet.give(Lead((1, 2), 1))
    published = {1: Heading(1.0), 2: Heading(2.0)}
    assert received_heading(fleet, 1, published) is None
    assert received_heading(fleet, 2, published) == Heading(1.0)


def test_leader_outside_formation_uses_the_heading_of_a_flying_leader() -> None:
    fleet = CooperatingFleet(RING, (1, 2))
    fleet.give(Lead((1, 2), 1))
    fleet.phases[1] = FlightPhase.HOLD
    assert received_heading(fleet, 1, {2: Heading(2.0)}) == Heading(2.0)


# ---------------------------------------------------------------- files


def turning(**changes: object) -> FleetConfig:
    return replace(load_fleet(PAIR), formation_heading="course", **changes)  # type: ignore[arg-type]


def refusal(fleet: FleetConfig, reference: Reference) -> str:
    with pytest.raises(ConfigError) as caught:
        check_reference(Path("v.yaml"), fleet, reference, slots_enu_m={1: ZERO3, 2: (-3.0, 4.0, 0.0)})
    return str(caught.value)


def test_fleet_file_selects_fixed_or_course_heading(tmp_path: Path) -> None:
    file = tmp_path / "fleet.yaml"
    file.write_text(PAIR.read_text() + "\nformation_heading: course\n")
    assert load_fleet(file).slots_turn
    assert not load_fleet(PAIR).slots_turn
    assert load_fleet(file).formation_hash() != load_fleet(PAIR).formation_hash()
    file.write_text(PAIR.read_text() + "\nformation_heading: north\n")
    with pytest.raises(ConfigError, match="formation_heading: 'north': expected one of course, fixed"):
        load_fleet(file)


def test_fence_check_covers_every_heading() -> None:
    fleet = turning()
    near = PointReference((fleet.envelope.fence_max_enu_m[0] - 4.5, 0.0, 3.0))  # fixed, no slot lies to the east of it
    assert "puts vehicle 2 at x = " in refusal(fleet, near)
    check_reference(
        Path("v.yaml"), load_fleet(PAIR), near, slots_enu_m={1: ZERO3, 2: (-3.0, 4.0, 0.0)}
    )  # raises nothing


def test_course_that_turns_too_fast_is_refused_with_a_remedy() -> None:
    circle = CircleReference((0.0, 0.0, 3.0), 5.0, period_s=20.0)  # 2 pi / 20 = 0.31 rad/s; 1 m/s at 5 m are 0.2
    words = refusal(turning(), circle)
    assert "v.yaml: reference.period_s: 20 s turns the course by up to 0.31 rad/s" in words
    assert "reaches 5.0 m can 0.20; expected at least 31.5 s" in words
    check_reference(Path("v.yaml"), turning(), replace(circle, period_s=31.5), slots_enu_m={2: (-3.0, 4.0, 0.0)})
    check_reference(Path("v.yaml"), turning(slot_speed_m_s=2.0), circle, slots_enu_m={2: (-3.0, 4.0, 0.0)})
    check_reference(Path("v.yaml"), load_fleet(PAIR), circle, slots_enu_m={2: (-3.0, 4.0, 0.0)})


def test_speed_and_tilt_are_reserved_for_the_rotation() -> None:
    speed_m_s, acceleration_m_s2 = most_pace(load_fleet(PAIR))
    less_speed_m_s, less_acceleration_m_s2 = most_pace(turning(slot_speed_m_s=2.0))
    assert less_speed_m_s == pytest.approx(speed_m_s - 2.0)
    assert less_acceleration_m_s2 == pytest.approx(acceleration_m_s2 - SLOT_ACCELERATION_M_S2)
    fast = CircleReference((0.0, 0.0, 3.0), 30.0, period_s=12.0, ramp_s=30.0)
    assert "less what slots need that turn" not in refusal(load_fleet(PAIR), fast)
    assert "less what slots need that turn" in refusal(turning(), fast)


def test_heading_degrees_are_counted_from_east() -> None:
    found = course((cos(2.0), sin(2.0), 0.0), ZERO3, SLOWEST_M_S)
    assert found is not None
    assert degrees(found.angle_rad) == pytest.approx(degrees(2.0))
