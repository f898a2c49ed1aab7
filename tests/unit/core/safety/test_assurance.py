"""The monitor behind the filter: what must always hold, and nothing else."""

from __future__ import annotations

import dataclasses
from math import hypot, inf, nan, radians, tan

import pytest
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.core.safety.assurance import IN_A_ROW, SHARE, CommandMonitor
from companion.core.safety.limits import OutputLimits
from companion.core.safety.overspeed import FASTER_M_S
from companion.geometry.airspace import Airspace, Cylinder, Fence
from companion.types.autopilot import AttitudeTarget, VehicleState
from companion.types.flight import FlightPhase, Role
from companion.types.formation import FlownSlot
from companion.types.peers import LeaderReport, Motion, PeerPacket, Sender
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

FENCE = Fence((-50.0, -50.0, 1.0), (50.0, 50.0, 30.0))
LIMITS = OutputLimits(radians(25.0), radians(120.0), 0.6, 1.4, 10.0, FENCE)
SEPARATION_M = 2.0
NOW_S = 10.0


def monitor(*obstacles: Cylinder) -> CommandMonitor:
    return CommandMonitor(SEPARATION_M, Airspace(FENCE, obstacles), LIMITS)


def vehicle(velocity_enu_m_s: Vector3 = ZERO3, position_enu_m: Vector3 = (0.0, 0.0, 10.0)) -> VehicleState:
    return VehicleState(
        position_enu_m=position_enu_m, velocity_enu_m_s=velocity_enu_m_s, position_time_s=NOW_S, attitude_time_s=NOW_S
    )


def peer(position_enu_m: Vector3, velocity_enu_m_s: Vector3, phase: FlightPhase = FlightPhase.FORMATION) -> PeerState:
    packet = PeerPacket(
        sender=Sender(2, 1, 1, 1),
        phase=phase,
        role=Role.FOLLOWER,
        motion=Motion(position_enu_m, velocity_enu_m_s, ZERO3, 0.0, 0.0),
        leader=LeaderReport(2, None),
        slot=FlownSlot(ZERO3),
    )
    return PeerState(packet, NOW_S, 0.0, NOW_S)


def braked(given: Vector3, own: VehicleState, other: PeerState | None, at: CommandMonitor) -> bool:
    near = {2: other} if other else {}
    for _ in range(IN_A_ROW - 1):
        assert at.acceleration(NOW_S, own, near, given) is given
    allowed = at.acceleration(NOW_S, own, near, given)
    at.acceleration(NOW_S, vehicle(), {}, ZERO3)  # nothing is found any more
    return allowed is not given


@pytest.mark.parametrize(
    ("apart_m", "closing_m_s", "brakes"),
    [
        (20.0, 4.0, False),
        (6.5, 4.0, False),
        (3.0, 4.0, True),
        (SHARE * SEPARATION_M + 0.2, 0.0, False),
        (0.5, -1.0, False),
    ],
)
def test_two_that_cooperate_can_still_stop(apart_m: float, closing_m_s: float, brakes: bool) -> None:
    other = peer((apart_m, 0.0, 10.0), (-0.5 * closing_m_s, 0.0, 0.0))
    assert braked(ZERO3, vehicle((0.5 * closing_m_s, 0.0, 0.0)), other, monitor()) is brakes


def test_it_brakes_against_the_velocity() -> None:
    at, own, other = monitor(), vehicle((2.0, 0.0, -1.0)), peer((2.0, 0.0, 10.0), ZERO3)
    allowed = [at.acceleration(NOW_S, own, {2: other}, (3.0, 0.0, 0.0)) for _ in range(IN_A_ROW)][-1]
    assert allowed[0] < 0.0 and allowed[1] == 0.0 and allowed[2] > 0.0


def test_the_command_counts_and_not_only_the_velocity() -> None:
    own, other = vehicle(), peer((SHARE * SEPARATION_M + 0.4, 0.0, 10.0), ZERO3)
    assert braked((4.0, 0.0, 0.0), own, other, monitor())
    assert not braked((-4.0, 0.0, 0.0), own, other, monitor())


def test_a_velocity_that_changes_its_sign_with_each_packet_stops_nobody() -> None:
    at, own, given = monitor(), vehicle(), (0.1, 0.0, 0.0)
    for tick in range(100):
        other = peer((3.0, 0.0, 10.0), (-11.9 if tick % 2 else 11.9, 0.0, 0.0))
        assert at.acceleration(NOW_S, own, {2: other}, given) is given


def test_who_passes_by_at_a_distance_is_let_pass() -> None:
    own = vehicle((4.0, 0.0, 0.0))
    assert not braked(ZERO3, own, peer((4.0, SEPARATION_M, 10.0), (-1.0, 0.0, 0.0)), monitor())
    assert braked(ZERO3, own, peer((4.0, 0.3, 10.0), (-1.0, 0.0, 0.0)), monitor())


def test_who_does_not_cooperate_is_the_filters_alone() -> None:
    own, other = vehicle((4.0, 0.0, 0.0)), peer((2.0, 0.0, 10.0), ZERO3, FlightPhase.HOLD)
    assert not braked(ZERO3, own, other, monitor())


@pytest.mark.parametrize(
    ("position_enu_m", "velocity_enu_m_s", "brakes"),
    [
        ((49.0, 0.0, 10.0), (3.0, 0.0, 0.0), True),
        ((49.0, 0.0, 10.0), (-3.0, 0.0, 0.0), False),
        ((0.0, -49.0, 10.0), (0.0, -3.0, 0.0), True),
        ((0.0, 0.0, 1.5), (0.0, 0.0, -2.0), True),
        ((0.0, 0.0, 29.5), (0.0, 0.0, 2.0), True),
        ((0.0, 0.0, 10.0), (5.0, 5.0, -2.0), False),
        ((51.0, 0.0, 10.0), (-1.0, 0.0, 0.0), False),  # outside, on its way back
    ],
)
def test_the_fence_can_still_be_kept(position_enu_m: Vector3, velocity_enu_m_s: Vector3, brakes: bool) -> None:
    assert braked(ZERO3, vehicle(velocity_enu_m_s, position_enu_m), None, monitor()) is brakes


def test_an_obstacle_can_still_be_avoided() -> None:
    at = monitor(Cylinder((5.0, 0.0), 1.0, 0.0, 20.0))
    assert braked(ZERO3, vehicle((4.0, 0.0, 0.0), (2.0, 0.0, 10.0)), None, at)
    assert not braked(ZERO3, vehicle((-4.0, 0.0, 0.0), (2.0, 0.0, 10.0)), None, at)
    assert not braked(ZERO3, vehicle((1.0, 0.0, 0.0), (0.0, 0.0, 10.0)), None, at)


LEVEL = AttitudeTarget(0.0, 0.0, 0.0, 0.5)


@pytest.mark.parametrize(
    "bad",
    [
        {"roll_rad": radians(26.0)},
        {"pitch_rad": nan},
        {"yaw_rad": inf},
        {"thrust_norm": 1.1},
        {"thrust_norm": -0.1},
        {"thrust_norm": nan},
        {"roll_rad": radians(20.0)},  # 20 degrees in a tick
    ],
)
def test_no_target_beyond_the_limits_is_sent(bad: dict[str, float]) -> None:
    at, own = monitor(), vehicle()
    assert at.permits(NOW_S, own, LEVEL)
    assert not at.permits(NOW_S + 0.02, own, AttitudeTarget(**{**_fields(LEVEL), **bad}))
    assert at.permits(NOW_S + 0.04, own, LEVEL)


def test_no_target_by_an_old_position_is_sent() -> None:
    at = monitor()
    assert not at.permits(NOW_S + 0.2, vehicle(), LEVEL)
    assert at.permits(NOW_S + 0.2, replace(vehicle(), position_time_s=NOW_S + 0.19), LEVEL)


def _fields(target: AttitudeTarget) -> dict[str, float]:
    return {name: getattr(target, name) for name in ("roll_rad", "pitch_rad", "yaw_rad", "thrust_norm")}


def test_level_flight_is_never_touched() -> None:
    given = (0.1, -0.1, 0.05)
    other = peer((SEPARATION_M, 0.0, 10.0), ZERO3)
    assert monitor().acceleration(NOW_S, vehicle((0.05, 0.0, 0.0)), {2: other}, given) is given


# ---------------------------------------------------------------- how far is just far enough

LEVEL_M_S2 = 0.8 * GRAVITY_M_S2 * tan(radians(25.0))
UP_M_S2, DOWN_M_S2 = 0.8 * GRAVITY_M_S2 * 0.2, 0.8 * GRAVITY_M_S2 * 0.3
NARROW = OutputLimits(radians(25.0), radians(120.0), 0.7, 1.2, 10.0, FENCE)


def stop_m(speed_m_s: float, braking_m_s2: float) -> float:
    """The way to a stop: 0.3 s until the braking acts, then with all of it."""
    return 0.3 * speed_m_s + speed_m_s**2 / (2.0 * braking_m_s2)


@pytest.mark.parametrize("obstacles", [(), (Cylinder((0.0, 48.0), 0.1, 0.0, 2.0),)], ids=["box", "obstacle"])
@pytest.mark.parametrize("speed_m_s", [0.8, 4.0])
@pytest.mark.parametrize(
    ("axis", "wall_m", "braking_m_s2"),
    [
        (0, 50.0, LEVEL_M_S2),
        (0, -50.0, LEVEL_M_S2),
        (1, 50.0, LEVEL_M_S2),
        (1, -50.0, LEVEL_M_S2),
        (2, 1.0, UP_M_S2),
        (2, 30.0, DOWN_M_S2),
    ],
)
def test_it_brakes_from_where_the_way_to_a_wall_is_too_short(
    axis: int, wall_m: float, braking_m_s2: float, speed_m_s: float, obstacles: tuple[Cylinder, ...]
) -> None:
    """In climb with less than in level flight; what flies along the wall does not matter."""
    outwards = 1.0 if wall_m == max(wall_m, FENCE.max_enu_m[axis]) else -1.0
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE, obstacles), NARROW)
    for share, brakes in ((1.02, False), (0.98, True)):
        place, velocity = [3.0, -7.0, 15.0], [0.5, -0.4, 0.3]
        place[axis] = wall_m - outwards * share * stop_m(speed_m_s, braking_m_s2)
        velocity[axis] = outwards * speed_m_s
        assert braked(ZERO3, vehicle(tuple(velocity), tuple(place)), None, at) is brakes


@pytest.mark.parametrize("speed_m_s", [0.09, 0.1, 0.11])
def test_a_drift_into_a_wall_is_noise_up_to_a_tenth_of_a_metre_per_second(speed_m_s: float) -> None:
    touches = vehicle((speed_m_s, 0.0, 0.0), (50.0, 0.0, 10.0))
    assert braked(ZERO3, touches, None, monitor()) is (speed_m_s > 0.1)


@pytest.mark.parametrize(("max_ratio", "min_ratio"), [(3.0, 0.0), (1.2, 0.0), (3.0, 0.9)])
def test_the_vertical_braking_is_that_of_the_thrust_and_never_more_than_level(
    max_ratio: float, min_ratio: float
) -> None:
    limits = OutputLimits(radians(25.0), radians(120.0), min_ratio, max_ratio, 10.0, FENCE)
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE), limits)
    up_m_s2 = min(LEVEL_M_S2, 0.8 * GRAVITY_M_S2 * (max_ratio - 1.0))
    down_m_s2 = min(LEVEL_M_S2, 0.8 * GRAVITY_M_S2 * (1.0 - min_ratio))
    for wall_m, climb_m_s, braking_m_s2 in ((1.0, -2.0, up_m_s2), (30.0, 2.0, down_m_s2)):
        for share, brakes in ((1.02, False), (0.98, True)):
            z_m = wall_m - 0.5 * climb_m_s * share * stop_m(2.0, braking_m_s2)
            assert braked(ZERO3, vehicle((0.0, 0.0, climb_m_s), (0.0, 0.0, z_m)), None, at) is brakes


@pytest.mark.parametrize("age_s", [0.0, 0.25])
@pytest.mark.parametrize(
    "ahead", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.8, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)]
)
def test_two_vehicles_brake_from_where_their_ways_are_too_short(ahead: Vector3, age_s: float) -> None:
    """Both brake, to SHARE of the separation, in its metric: heights count half. What was sent has aged."""
    weight = 0.5 if ahead[2] else 1.0
    own_m_s, its_m_s, accel_m_s2 = 2.5, -1.1, -0.6
    closing_m_s = weight * (own_m_s - its_m_s - accel_m_s2 * (age_s + 0.3))
    # The velocity is that in RESPONDS_S, and the place that of the velocity which was sent.
    for share, brakes in ((1.02, False), (0.98, True)):
        apart_m = (0.65 * SEPARATION_M + share * stop_m(closing_m_s, 2.0 * LEVEL_M_S2)) / weight
        own_at, its_at = (1.0, -2.0, 12.0), apart_m - its_m_s * age_s
        place = tuple(p + a * its_at for p, a in zip(own_at, ahead, strict=True))
        other = peer(place, tuple(a * its_m_s for a in ahead))
        motion = replace(other.packet.motion, acceleration_enu_m_s2=tuple(a * accel_m_s2 for a in ahead))
        aged = PeerState(replace(other.packet, motion=motion), NOW_S - age_s, 0.0, NOW_S - age_s)
        own = vehicle(tuple(a * own_m_s for a in ahead), own_at)
        assert braked(ZERO3, own, aged, monitor()) is brakes


def test_it_asks_where_the_vehicle_is_now_and_not_where_it_was() -> None:
    """The own position as well is some hundredths of a second old."""
    for axis in range(3):
        ahead = [0.0, 0.0, 0.0]
        ahead[axis] = 1.0
        weight = 0.5 if axis == 2 else 1.0
        for share, brakes in ((1.02, False), (0.98, True)):
            apart_m = (0.65 * SEPARATION_M + share * stop_m(weight * 4.0, 2.0 * LEVEL_M_S2)) / weight + 4.0 * 0.08
            own = replace(vehicle(tuple(4.0 * a for a in ahead)), position_time_s=NOW_S - 0.08)
            other = peer(tuple(p + a * apart_m for p, a in zip((0.0, 0.0, 10.0), ahead, strict=True)), ZERO3)
            assert braked(ZERO3, own, other, monitor()) is brakes


def test_vehicles_that_pass_each_other_are_judged_where_they_are_nearest() -> None:
    own = vehicle((4.0, 0.0, 0.0))
    for aside_m, brakes in ((0.66 * SEPARATION_M, False), (0.64 * SEPARATION_M, True)):
        assert braked(ZERO3, own, peer((2.0, aside_m, 10.0), ZERO3), monitor()) is brakes
        assert braked(ZERO3, own, peer((2.0, -aside_m, 10.0), ZERO3), monitor()) is brakes
        assert braked(ZERO3, own, peer((2.0, 0.0, 10.0 - 2.0 * aside_m), ZERO3), monitor()) is brakes


def test_one_that_parts_flies_abreast_or_does_not_cooperate_hides_none_that_comes() -> None:
    own = vehicle((4.0, 0.0, 0.0))
    behind, held = peer((-1.0, 0.0, 10.0), ZERO3), peer((2.0, 0.0, 10.0), ZERO3, FlightPhase.HOLD)
    abreast = peer((0.0, 1.0, 10.0), (4.0, 0.0, 0.0))
    near = {2: abreast, 3: behind, 4: held, 5: peer((2.0, 0.0, 10.0), ZERO3)}
    at = monitor()
    assert [at.acceleration(NOW_S, own, near, ZERO3) is ZERO3 for _ in range(4)] == [True, True, False, False]


def test_who_flies_ahead_abreast_of_another_parts_from_it() -> None:
    abreast = peer((0.0, 1.0, 10.0), ZERO3)
    assert not braked(ZERO3, vehicle((2.0, 0.0, 0.0)), abreast, monitor())
    assert braked(ZERO3, vehicle((2.0, 0.1, 0.0)), abreast, monitor())


def test_a_slow_approach_inside_the_share_is_noise() -> None:
    for closing_m_s, brakes in ((0.09, False), (0.1, False), (0.11, True)):
        other = peer((1.0, 0.0, 10.0), (-closing_m_s, 0.0, 0.0))
        assert braked(ZERO3, vehicle(), other, monitor()) is brakes


def test_it_brakes_the_velocity_away_within_a_quarter_of_a_second() -> None:
    at, own, other = monitor(), vehicle((2.0, -0.4, -1.0)), peer((2.0, 0.0, 10.0), ZERO3)
    allowed = [at.acceleration(NOW_S, own, {2: other}, (3.0, 0.0, 0.0)) for _ in range(IN_A_ROW)][-1]
    assert allowed == pytest.approx((-8.0, 1.6, 4.0))


def test_the_command_counts_on_each_axis_for_the_time_until_it_acts() -> None:
    """0.3 s of 5 m/s^2 are 1.5 m/s."""
    for axis in range(3):
        weight, ahead = 0.5 if axis == 2 else 1.0, [0.0, 0.0, 0.0]
        ahead[axis] = 1.0
        for share, brakes in ((1.02, False), (0.98, True)):
            apart_m = (0.65 * SEPARATION_M + share * stop_m(weight * 1.5, 2.0 * LEVEL_M_S2)) / weight
            other = peer(tuple(p + a * apart_m for p, a in zip((0.0, 0.0, 10.0), ahead, strict=True)), ZERO3)
            assert braked(tuple(5.0 * a for a in ahead), vehicle(), other, monitor()) is brakes


# ---------------------------------------------------------------- the target


@pytest.mark.parametrize("name", ["roll_rad", "pitch_rad"])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_target_steps_no_farther_than_the_rate_in_a_tenth_of_a_second(name: str, sign: float) -> None:
    largest_rad = LIMITS.max_tilt_rate_rad_s * 0.1 + 1e-3  # of rounding
    for step_rad, sent in ((largest_rad, True), (1.001 * largest_rad, False)):
        for from_rad in (0.0, sign * 0.125):
            at, before = monitor(), AttitudeTarget(**{**_fields(LEVEL), name: from_rad})
            assert at.permits(NOW_S, vehicle(), before)
            wanted = AttitudeTarget(**{**_fields(LEVEL), name: from_rad + sign * step_rad})
            assert at.permits(NOW_S + 0.02, vehicle(), wanted) is sent


def test_a_stream_that_begins_steps_to_any_permitted_attitude() -> None:
    own, at = replace(vehicle(), position_time_s=0.2), monitor()
    tilted = AttitudeTarget(radians(-24.0), 0.0, 0.0, 0.5)
    assert at.permits(0.0, own, LEVEL)
    assert not at.permits(0.1, own, tilted)
    assert at.permits(0.11, own, tilted)
    assert not at.permits(0.13, own, LEVEL)  # it slews from what was sent last


def test_the_tilt_is_that_of_both_angles_with_a_margin_for_rounding() -> None:
    assert monitor().permits(NOW_S, vehicle(), AttitudeTarget(LIMITS.max_tilt_rad + 1e-3, 0.0, 0.0, 0.5))
    for tilt_rad, sent in ((radians(25.0) + 0.0009, True), (radians(25.0) + 0.0011, False)):
        for roll, pitch in ((1.0, 0.0), (0.0, -1.0), (0.6, -0.8)):
            assert hypot(roll, pitch) == pytest.approx(1.0)
            target = AttitudeTarget(roll * tilt_rad, pitch * tilt_rad, 0.0, 0.5)
            assert monitor().permits(NOW_S, vehicle(), target) is sent


@pytest.mark.parametrize("thrust_norm", [0.0, 1.0])
def test_all_of_the_range_of_the_thrust_is_permitted(thrust_norm: float) -> None:
    assert monitor().permits(NOW_S, vehicle(), AttitudeTarget(0.0, 0.0, 0.0, thrust_norm))


def test_a_position_of_a_tenth_of_a_second_is_new_enough() -> None:
    own = replace(vehicle(), position_time_s=0.0)
    assert monitor().permits(0.1, own, LEVEL)
    assert not monitor().permits(0.101, own, LEVEL)


SPEEDS = dataclasses.replace(LIMITS, max_speed_m_s=12.0, max_climb_m_s=3.0, max_descent_m_s=2.0)


@pytest.mark.parametrize(
    ("velocity_enu_m_s", "flees_enu_m_s2"),
    [
        ((0.0, 0.0, 4.0), (0.5, 0.0, 4.0)),
        ((0.0, 0.0, -3.0), (0.5, 0.0, -4.0)),
        ((7.5, 10.0, 0.0), (3.0, 4.0, 0.5)),
    ],
)
def test_a_speed_above_its_limit_is_braked_in_time_to_be_below_it_after_a_second(
    velocity_enu_m_s: Vector3, flees_enu_m_s2: Vector3
) -> None:
    """A vehicle that flees from another one, which follows it."""
    at, (vx, vy, vz) = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), SPEEDS), velocity_enu_m_s
    excess_m_s = []
    for tick in range(51):
        now_s = NOW_S + 0.02 * tick
        excess_m_s.append(max(hypot(vx, vy) - 12.0, vz - 3.0, -vz - 2.0))
        flown = replace(vehicle((vx, vy, vz)), position_time_s=now_s)
        ux, uy, uz = at.acceleration(now_s, flown, {}, flees_enu_m_s2)
        vx, vy, vz = vx + 0.02 * ux, vy + 0.02 * uy, vz + 0.02 * uz
    assert min(excess_m_s) <= FASTER_M_S
    assert excess_m_s[1] > excess_m_s[0]  # at first it flees, as the filter wants


def test_a_speed_within_its_limits_or_above_them_for_a_moment_is_let_be() -> None:
    at, given = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), SPEEDS), (3.0, 0.0, 3.0)
    for tick in range(500):
        now_s, faster_m_s = NOW_S + 0.02 * tick, 0.5 if tick % 25 < 10 else 0.0
        flown = replace(vehicle((12.0 + faster_m_s, 0.0, 3.0 + faster_m_s)), position_time_s=now_s)
        assert at.acceleration(now_s, flown, {}, given) is given


def slowed(velocity_enu_m_s: Vector3, wanted_enu_m_s2: Vector3, for_s: float) -> Vector3:
    """What is flown of this wish by a vehicle that has been so fast for this time."""
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), dataclasses.replace(NARROW, **LIMITED))
    flown = wanted_enu_m_s2
    for now_s in (NOW_S, NOW_S + for_s):
        own = replace(vehicle(velocity_enu_m_s), position_time_s=now_s)
        flown = at.acceleration(now_s, own, {}, wanted_enu_m_s2)
    return flown


LIMITED = {"max_speed_m_s": 12.0, "max_climb_m_s": 3.0, "max_descent_m_s": 2.0}


@pytest.mark.parametrize("excess_m_s", [0.3, 0.6])
def test_a_speed_is_braked_once_there_is_no_more_time_than_that_takes(excess_m_s: float) -> None:
    """Within a second, less the 0.3 s of the response and the time of full braking; by 4 m/s^2 for each m/s of excess."""
    ways = (
        ((0.6 * (12.0 + excess_m_s), -0.8 * (12.0 + excess_m_s), 0.0), (0.6, -0.8, 0.0), LEVEL_M_S2),
        ((0.0, 0.0, 3.0 + excess_m_s), (0.0, 0.0, 1.0), DOWN_M_S2),
        ((0.0, 0.0, -2.0 - excess_m_s), (0.0, 0.0, -1.0), UP_M_S2),
    )
    for velocity, (nx, ny, nz), most_m_s2 in ways:
        begins_s, wanted = 0.7 - excess_m_s / most_m_s2, (1.0, 0.5, 0.2)
        assert slowed(velocity, wanted, begins_s - 0.001) is wanted
        x, y, z = slowed(velocity, wanted, begins_s + 0.001)
        assert nx * x + ny * y + nz * z == pytest.approx(-min(most_m_s2, 4.0 * excess_m_s))
        across = [(a, b) for a, b, n in zip((x, y, z), wanted, (nx, ny, nz), strict=True) if n == 0.0]
        assert all(a == b for a, b in across)
        assert -ny * x + nx * y == pytest.approx(-ny * wanted[0] + nx * wanted[1])
        brakes = tuple(-9.0 * n for n in (nx, ny, nz))
        assert slowed(velocity, brakes, begins_s + 0.001) is brakes  # as the filter wants


def test_an_excess_is_noise_up_to_two_tenths_and_ends_its_time() -> None:
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), dataclasses.replace(NARROW, **LIMITED))
    wanted = (1.0, 0.0, 1.0)

    def flown(now_s: float, velocity: Vector3) -> Vector3:
        return at.acceleration(now_s, replace(vehicle(velocity), position_time_s=now_s), {}, wanted)

    for fast, slow in (
        ((12.5, 0.0, 0.0), (12.19, 0.0, 0.0)),
        ((0.0, 0.0, 3.5), (0.0, 0.0, 3.19)),
        *(((x, 0.0, z), ZERO3) for x, z in ((12.5, 0.0), (0.0, 3.5), (0.0, -2.5))),
    ):
        assert flown(20.0, fast) is wanted
        assert flown(20.9, slow) is wanted
        assert flown(21.0, fast) is wanted
        assert flown(21.9, fast) is not wanted
        assert flown(30.0, slow) is wanted
    for now_s in (40.0, 49.0):
        assert flown(now_s, (0.0, 0.0, -2.19)) is wanted
        assert flown(now_s, (0.0, -12.19, 3.19)) is wanted
    both = (-12.5, 0.0, -2.5)
    flown(50.0, both)
    x, y, z = flown(51.0, both)
    assert (x, y, z) == pytest.approx((2.0, 0.0, UP_M_S2))


def test_a_vehicle_without_limits_of_speed_is_never_slowed() -> None:
    at, wanted = monitor(), (1.0, 0.0, 1.0)
    for now_s in (NOW_S, NOW_S + 9.0):
        own = replace(vehicle((20.0, 0.0, 5.0), (-40.0, 0.0, 2.0)), position_time_s=now_s)
        assert at.acceleration(now_s, own, {}, wanted) is wanted


@pytest.mark.parametrize("climb_m_s", [-2.19, -1.9, 0.0, 1.9, 3.19])
@pytest.mark.parametrize("wanted_up_m_s2", [-9.0, -0.5, 9.0])
def test_within_the_limits_of_speed_a_wish_is_let_be_for_ever(climb_m_s: float, wanted_up_m_s2: float) -> None:
    wanted = (0.0, 0.0, wanted_up_m_s2)
    at = CommandMonitor(SEPARATION_M, Airspace(Fence((-9e3, -9e3, -9e3), (9e3, 9e3, 9e3)), ()), SPEEDS)
    for now_s in (NOW_S, NOW_S + 9.0):
        own = replace(vehicle((0.0, 0.0, climb_m_s)), position_time_s=now_s)
        assert at.acceleration(now_s, own, {}, wanted) is wanted


def test_a_slow_fleet_is_slowed_at_its_own_limit() -> None:
    slow = dataclasses.replace(SPEEDS, max_speed_m_s=1.0)
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), slow)
    for now_s in (NOW_S, NOW_S + 2.0):
        found = at.acceleration(now_s, replace(vehicle((1.3, 0.0, 0.0)), position_time_s=now_s), {}, ZERO3)
    assert found == pytest.approx((-1.2, 0.0, 0.0))


def test_a_slow_fleet_brakes_its_climb_downwards() -> None:
    slow = dataclasses.replace(SPEEDS, max_climb_m_s=0.4)
    at = CommandMonitor(SEPARATION_M, Airspace(FENCE, ()), slow)
    at.acceleration(NOW_S, vehicle((0.0, 0.0, 0.8)), {}, ZERO3)
    own = replace(vehicle((0.0, 0.0, 0.8)), position_time_s=NOW_S + 2.0)
    assert at.acceleration(NOW_S + 2.0, own, {}, ZERO3) == pytest.approx((0.0, 0.0, -1.6))
