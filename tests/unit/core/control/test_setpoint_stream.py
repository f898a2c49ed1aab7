"""The stream of one vehicle's setpoints from its beginning to its silence, and the descent by thrust."""

from __future__ import annotations

from math import cos, degrees, hypot, inf, nan, radians, tan

import pytest
from msgspec.structs import replace

from companion.core.consensus.peers import PeerState
from companion.core.control.descent import Descent
from companion.core.control.setpoint import SetpointStream, attitude_target, level_acceleration, limit_acceleration
from companion.core.estimation.wind import DisturbanceObserver
from companion.core.safety.assurance import IN_A_ROW, CommandMonitor
from companion.core.safety.limits import OutputLimits
from companion.geometry.airspace import Airspace, Fence
from companion.types.autopilot import AttitudeTarget, VehicleState
from companion.types.notices import Code
from companion.types.values import GRAVITY_M_S2, ZERO3, Vector3

FENCE = Fence((-50.0, -50.0, -5.0), (50.0, 50.0, 50.0))
LIMITS = OutputLimits(radians(25.0), radians(200.0), 0.3, 1.6, 10.0, FENCE)
HOVER = 0.5
TICK_S = 0.02
FLIES = VehicleState(
    position_enu_m=(1.0, 2.0, 10.0), position_time_s=0.0, roll_rad=0.1, pitch_rad=-0.2, yaw_rad=0.7, attitude_time_s=0.0
)


def stream(disturbance_enu_m_s2: Vector3 = ZERO3) -> SetpointStream:
    observer = DisturbanceObserver(HOVER, 0.25, 0.0)
    observer.disturbance_enu_m_s2 = disturbance_enu_m_s2
    return SetpointStream(LIMITS, observer, CommandMonitor(2.0, Airspace(FENCE), LIMITS))


def at_s(now_s: float, **changes: object) -> VehicleState:
    return replace(FLIES, position_time_s=now_s, attitude_time_s=now_s, **changes)


def followed(sent: SetpointStream, wanted: Vector3, vehicle: VehicleState = FLIES, ticks: int = 20) -> AttitudeTarget:
    """The setpoint after so many ticks with the same wish."""
    target = None
    for tick in range(1, ticks + 1):
        now_s = TICK_S * tick
        target = sent.follow(now_s, replace(vehicle, position_time_s=now_s), wanted)
    assert target is not None
    return target


def test_a_stream_begins_with_what_the_vehicle_does() -> None:
    sent = stream()
    sent.open(3.0, at_s(3.0, thrust_norm=0.62, thrust_time_s=2.8))
    assert sent.sent == AttitudeTarget(0.1, -0.2, 0.7, 0.62)
    assert (sent.sent_s, sent.commanded_enu_m_s2, sent.largest_step_deg) == (3.0, ZERO3, 0.0)
    carried = sent.carry_on(3.02, at_s(3.02, thrust_norm=0.62, thrust_time_s=2.8))
    assert carried == AttitudeTarget(0.1, -0.2, 0.7, 0.62)
    assert (sent.sent_s, sent.position_used_s, sent.commanded_enu_m_s2) == (3.02, 3.02, ZERO3)


@pytest.mark.parametrize(("age_s", "is_fresh"), [(0.3, True), (0.301, False)])
def test_an_old_thrust_is_replaced_by_the_one_that_carries_the_vehicle(age_s: float, is_fresh: bool) -> None:
    sent = stream()
    sent.open(age_s, at_s(age_s, thrust_norm=0.62, thrust_time_s=0.0))
    assert sent.sent.thrust_norm == pytest.approx(0.62 if is_fresh else HOVER / (cos(0.1) * cos(0.2)))


def test_a_vehicle_far_from_level_is_carried_by_no_more_than_twice_its_weight() -> None:
    sent = stream()
    sent.open(1.0, at_s(1.0, roll_rad=radians(70.0), pitch_rad=radians(20.0)))
    assert sent.sent.thrust_norm == pytest.approx(HOVER / 0.5)


def test_the_heading_stays_that_of_the_beginning() -> None:
    sent = stream()
    sent.open(0.0, FLIES)
    assert followed(sent, ZERO3, replace(FLIES, yaw_rad=-2.0)).yaw_rad == pytest.approx(0.7)


@pytest.mark.parametrize("disturbance", [ZERO3, (0.8, -0.5, 0.0)])
def test_a_wish_is_flown_against_the_disturbance(disturbance: Vector3) -> None:
    """The attitude is that of the wish less the disturbance; what is reported is the wish."""
    sent, wanted = stream(disturbance), (1.0, -0.7, 0.4)
    sent.open(0.0, FLIES)
    target = followed(sent, wanted)
    needed = (wanted[0] - disturbance[0], wanted[1] - disturbance[1], wanted[2])
    expected = attitude_target(needed, 0.7, FLIES.roll_rad, FLIES.pitch_rad, HOVER)
    assert [target.roll_rad, target.pitch_rad, target.thrust_norm] == pytest.approx(
        [expected.roll_rad, expected.pitch_rad, expected.thrust_norm]
    )
    assert sent.commanded_enu_m_s2 == pytest.approx(wanted)
    assert (sent.sent, sent.sent_s, sent.position_used_s) == (target, 0.4, 0.4)


def test_a_wish_beyond_the_limits_is_reported_as_it_is_flown() -> None:
    sent, disturbance = stream((0.5, 0.0, 0.0)), 0.5
    sent.open(0.0, FLIES)
    followed(sent, (30.0, 0.0, 20.0))
    lift_m_s2 = 1.6 * GRAVITY_M_S2
    expected = (lift_m_s2 * tan(radians(25.0)) + disturbance, 0.0, lift_m_s2 - GRAVITY_M_S2)
    assert sent.commanded_enu_m_s2 == pytest.approx(expected)
    followed(sent, (0.0, 0.0, -20.0))
    assert sent.commanded_enu_m_s2[2] == pytest.approx(0.3 * GRAVITY_M_S2 - GRAVITY_M_S2)


def test_the_largest_step_is_of_both_angles_and_since_the_stream_began() -> None:
    sent = stream()
    sent.open(0.0, at_s(0.0))
    sent.carry_on(0.02, at_s(0.02, roll_rad=0.13, pitch_rad=-0.24))
    sent.carry_on(0.04, at_s(0.04, roll_rad=0.14, pitch_rad=-0.24))
    assert sent.largest_step_deg == pytest.approx(degrees(hypot(0.03, 0.04)))
    sent.open(1.0, at_s(1.0))
    assert sent.largest_step_deg == 0.0


def test_what_gives_no_attitude_is_counted_and_not_sent() -> None:
    """Upside down; and no second decision by the same position."""
    sent = stream()
    sent.open(0.0, FLIES)
    assert sent.follow(0.02, at_s(0.02, roll_rad=2.0), ZERO3) is None
    assert (sent.position_used_s, sent.sent_s) == (0.02, 0.0)
    assert sent.rejected == {Code.SETPOINT_IMPOSSIBLE: 1}


@pytest.mark.parametrize("is_open", [False, True])
def test_what_is_not_admitted_is_counted_and_not_sent(is_open: bool) -> None:
    """Without a stream; or by a position that the monitor refuses."""
    sent, old_s = stream(), -0.2
    if is_open:
        sent.open(0.0, FLIES)
    before = sent.sent
    assert sent.follow(0.02, replace(FLIES, position_time_s=old_s if is_open else 0.02), ZERO3) is None
    assert sent.rejected == {Code.SETPOINT_IMPOSSIBLE: 1}
    assert sent.sent is before
    assert sent.position_used_s == (old_s if is_open else 0.02)


def test_a_stream_has_used_no_position_at_first() -> None:
    sent = stream()
    assert (sent.position_used_s, sent.commanded_enu_m_s2, sent.rejected) == (-inf, ZERO3, {})
    assert (sent.sent_s, sent.largest_step_deg) == (0.0, 0.0)


def test_one_setpoint_that_brakes_goes_before_each_silence_without_slewing() -> None:
    """From 1.2 m/s with 0.8 m/s^2; at most with 1.5 m/s^2, whatever the velocity was."""
    sent = stream()
    sent.open(0.0, FLIES)
    followed(sent, (3.0, 0.0, 1.0))
    last_s, slow = sent.sent_s, (1.2, 0.0, 0.0)
    last = sent.last_before_silence(last_s + 0.041, slow)
    assert last is not None
    flown = level_acceleration(last.roll_rad, last.pitch_rad, last.yaw_rad)
    assert flown == pytest.approx((-0.8, 0.0), abs=1e-6)
    assert sent.commanded_enu_m_s2 == ZERO3
    assert sent.last_before_silence(last_s + 0.06, slow) is None
    assert sent.carry_on(last_s + 0.1, at_s(last_s + 0.1, roll_rad=0.02, pitch_rad=0.0))
    again = sent.last_before_silence(last_s + 0.15, (0.0, 9.0, 0.0))
    assert again is not None
    flown = level_acceleration(again.roll_rad, again.pitch_rad, again.yaw_rad)
    assert flown == pytest.approx((0.0, -1.5), abs=1e-6)


def test_the_last_setpoint_brakes_in_each_direction_against_the_wind() -> None:
    """It leans into the wind by what that does, and pulls less where it lifts."""
    sent = stream((0.4, -0.3, 0.2))
    sent.open(0.0, FLIES)
    last = sent.last_before_silence(0.05, (0.9, -0.6, 0.0))
    assert last is not None
    lift = last.thrust_norm / HOVER
    east, north = level_acceleration(last.roll_rad, last.pitch_rad, last.yaw_rad)
    assert lift == pytest.approx(1.0 - 0.2 / GRAVITY_M_S2)
    assert (lift * east, lift * north) == pytest.approx((-0.6 - 0.4, 0.4 + 0.3))


def test_the_last_setpoint_carries_a_vehicle_that_climbs_or_sinks() -> None:
    sent = stream()
    sent.open(0.0, FLIES)
    followed(sent, (0.0, 0.0, 0.0))
    last = sent.last_before_silence(sent.sent_s + 0.05, (0.0, 0.0, -0.75))
    assert last is not None and last.thrust_norm == pytest.approx(HOVER * (1.0 + 0.5 / GRAVITY_M_S2))


def test_an_agent_that_was_frozen_sends_no_late_last_setpoint() -> None:
    sent = stream()
    sent.open(0.0, FLIES)
    followed(sent, (3.0, 0.0, 1.0))
    last_s = sent.sent_s
    assert sent.last_before_silence(last_s + 0.21, FLIES.velocity_enu_m_s) is None
    assert sent.last_before_silence(last_s + 0.19, FLIES.velocity_enu_m_s) is not None


def test_a_stream_that_has_sent_nothing_hovers_before_its_silence_too() -> None:
    sent = stream()
    sent.open(0.0, FLIES)
    assert sent.last_before_silence(0.04, FLIES.velocity_enu_m_s) == AttitudeTarget(0.0, 0.0, 0.7, HOVER)


def test_a_setpoint_is_believed_to_be_flown_for_a_while() -> None:
    sent = stream()
    sent.open(0.0, FLIES)
    followed(sent, (1.0, 0.0, 0.0), ticks=1)
    believed = [sent.flown_acceleration_enu_m_s2(now_s, 0.04)[0] for now_s in (0.02, 0.06, 0.061)]
    assert believed == pytest.approx([1.0, 1.0, 0.0])


def test_a_command_that_the_monitor_brakes_is_counted() -> None:
    sent, given = stream(), (2.0, 0.0, 0.0)
    flies_out = at_s(1.0, position_enu_m=(49.5, 0.0, 10.0), velocity_enu_m_s=(3.0, 0.0, 0.0))
    near: dict[int, PeerState] = {}
    found = [sent.checked(1.0, flies_out, near, given) for _ in range(IN_A_ROW)]
    assert [each is given for each in found] == [True] * (IN_A_ROW - 1) + [False]
    assert found[-1][0] < 0.0
    assert sent.rejected == {Code.COMMAND_BRAKED: 1}


def test_the_largest_level_acceleration_is_that_of_the_tilt() -> None:
    assert stream().largest_level_m_s2 == pytest.approx(GRAVITY_M_S2 * tan(radians(25.0)))


# ---------------------------------------------------------------- acceleration and attitude


@pytest.mark.parametrize("lift", [0.3, 1.0, 1.6])
def test_the_level_part_is_limited_by_the_lift_that_is_left(lift: float) -> None:
    most_m_s2 = lift * GRAVITY_M_S2 * tan(radians(25.0))
    up_m_s2 = (lift - 1.0) * GRAVITY_M_S2
    for share, kept in ((0.99, 0.99), (1.5, 1.0)):
        wanted = (0.6 * share * most_m_s2, -0.8 * share * most_m_s2, up_m_s2)
        expected = (0.6 * kept * most_m_s2, -0.8 * kept * most_m_s2, up_m_s2)
        assert limit_acceleration(wanted, radians(25.0), 0.3, 1.6) == pytest.approx(expected)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.9, -2.5])
@pytest.mark.parametrize(("roll_rad", "pitch_rad"), [(0.0, 0.2), (0.3, 0.0), (-0.25, 0.4)])
def test_the_acceleration_of_an_attitude_is_that_of_its_thrust(
    roll_rad: float, pitch_rad: float, yaw_rad: float
) -> None:
    """Ahead by the pitch; to the right by the roll, of the larger thrust that carries a pitched vehicle."""
    ahead, right = GRAVITY_M_S2 * tan(pitch_rad), GRAVITY_M_S2 * tan(roll_rad) / cos(pitch_rad)
    east, north = level_acceleration(roll_rad, pitch_rad, yaw_rad)
    assert cos(yaw_rad) * east + cos(yaw_rad - radians(90.0)) * north == pytest.approx(ahead)
    assert cos(yaw_rad - radians(90.0)) * east - cos(yaw_rad) * north == pytest.approx(right)


def test_a_tilt_beyond_a_right_angle_about_both_axes_is_no_flight() -> None:
    """Both cosines are negative, and their product is not."""
    assert level_acceleration(2.0, 2.0, 0.0) == (0.0, 0.0)
    with pytest.raises(ValueError, match="no attitude"):
        attitude_target(ZERO3, 0.0, nan, 0.0, HOVER)


# ---------------------------------------------------------------- the descent by thrust


def sinking(climb_m_s: float) -> VehicleState:
    return replace(FLIES, velocity_enu_m_s=(5.0, -3.0, climb_m_s))


@pytest.mark.parametrize(("climb_m_s", "up_m_s2"), [(0.0, -1.4), (-0.7, 0.0), (-1.2, 1.0), (0.8, -3.0)])
def test_a_descent_is_level_towards_seven_decimetres_a_second(climb_m_s: float, up_m_s2: float) -> None:
    """Whatever the horizontal velocity is said to be."""
    x, y, z = Descent().acceleration_enu_m_s2(0.0, sinking(climb_m_s))
    assert (x, y, z) == pytest.approx((0.0, 0.0, up_m_s2))


def test_a_vehicle_that_sinks_no_more_for_a_second_stands() -> None:
    descent = Descent()
    thrusts = [(0.0, -0.3), (5.0, -0.21), (6.0, -0.2), (6.01, -0.2), (6.02, -0.21), (7.02, 0.0), (7.03, 0.0)]
    stands = [descent.acceleration_enu_m_s2(now_s, sinking(climb)) == (0.0, 0.0, -6.0) for now_s, climb in thrusts]
    assert stands == [False, False, False, True, False, False, True]
    descent.restart()
    assert descent.acceleration_enu_m_s2(9.0, sinking(0.0))[2] == pytest.approx(-1.4)
