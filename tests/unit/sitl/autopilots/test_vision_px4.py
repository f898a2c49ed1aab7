"""The PX4 stand-in with external vision in place of GPS, against measurements on PX4 v1.16: bytes in, bytes out."""

from __future__ import annotations

from math import hypot, radians

import pytest

from companion.mavlink.codec import mavlink as M  # noqa: N812 -- short, used in most lines
from laboratory import DT_S, PX4, Laboratory
from sitl.vehicle.config import PositionLoss

ACCEPTED, LATER, DENIED = 0, 1, 2
ORIGIN, HOME = M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, M.MAVLINK_MSG_ID_HOME_POSITION
OFFBOARD, TAKEOFF, LOITER, LAND, POSCTL = (6.0, 0.0), (4.0, 2.0), (4.0, 3.0), (4.0, 6.0), (3.0, 0.0)
UNSTABLE = "Preflight Fail: horizontal position unstable"


def hover(altitude_m: float | None = 0.0, **stand_in: object) -> Laboratory:
    """2 m above the ground in OFFBOARD, by a stream of positions; with an origin at this altitude, if any."""
    lab = Laboratory(PX4, **stand_in)
    lab.fly(0.5)
    if altitude_m is not None:
        lab.set_origin(altitude_m)
    lab.fly(4.5)
    lab.goal_ned_m = (0.0, 0.0, -2.0)
    lab.fly(0.2)
    lab.set_mode(*OFFBOARD)
    assert lab.arm() == [ACCEPTED]
    lab.fly(6.0)
    assert lab.height_m == pytest.approx(2.0, abs=0.3)
    return lab


def flags_change_s(lab: Laboratory, to: int, within_s: float) -> float:
    return lab.until(lambda: lab.flags == to, within_s, pose_hz=0.0)


# ---------------------------------------------------------------- without vision


def test_without_vision_it_reports_zeros_and_no_place() -> None:
    lab = Laboratory(PX4, sensors="default")
    lab.fly(6.0, pose_hz=0.0)
    positions = lab.messages("LOCAL_POSITION_NED")
    assert len(positions) == pytest.approx(300, abs=2)
    assert {(m.x, m.y, m.z, m.vx, m.vy, m.vz) for m in positions} == {(0.0,) * 6}
    assert lab.flags == 0xE5
    assert not lab.messages("GLOBAL_POSITION_INT")
    assert lab.command(M.MAV_CMD_REQUEST_MESSAGE, ORIGIN) == [DENIED]
    assert lab.command(M.MAV_CMD_REQUEST_MESSAGE, HOME) == [DENIED]
    assert lab.arm() == [LATER]
    assert "Arming denied: Resolve system health failures first" in lab.texts


def test_its_parameters_say_so() -> None:
    vision, gps = Laboratory(PX4), Laboratory(PX4, positioning="gps")
    for name, by_vision, by_gps in (("EKF2_GPS_CTRL", 0, 7), ("EKF2_EV_CTRL", 11, 0), ("SYS_HAS_GPS", 0, 1)):
        assert [lab.vehicle.parameters[name] for lab in (vision, gps)] == [by_vision, by_gps]


def test_with_gps_poses_change_nothing() -> None:
    lab, alone = Laboratory(PX4, positioning="gps"), Laboratory(PX4, positioning="gps")
    lab.shift_ned_m = (3.0, 0.0, 0.0)
    lab.fly(2.0)
    alone.fly(2.0, pose_hz=0.0)
    assert [m.get_msgbuf() for m in lab.received] == [m.get_msgbuf() for m in alone.received]


# ---------------------------------------------------------------- the first fix, and the origin


@pytest.mark.parametrize("message", ["VISION_POSITION_ESTIMATE", "ODOMETRY"])
def test_the_first_fix_comes_after_0_3_s_in_the_capture_frame(message: str) -> None:
    lab = Laboratory(PX4, message)
    lab.shift_ned_m = (1.5, -2.0, 0.25)
    lab.fly(1.0, pose_hz=0.0)
    assert lab.until(lambda: lab.flags == 0x1EF, 1.0) == pytest.approx(0.3, abs=0.03)
    lab.fly(0.1)
    assert lab.local_ned_m == pytest.approx((1.5, -2.0, 0.25), abs=0.02)
    assert not lab.messages("GLOBAL_POSITION_INT") + lab.messages("GPS_GLOBAL_ORIGIN") + lab.messages("HOME_POSITION")


@pytest.mark.parametrize(
    ("mode", "result"), [(LOITER, LATER), (POSCTL, LATER), (LAND, LATER), (TAKEOFF, ACCEPTED), (OFFBOARD, ACCEPTED)]
)
def test_without_an_origin_it_arms_in_two_modes(mode: tuple[float, float], result: int) -> None:
    lab = Laboratory(PX4)
    lab.goal_ned_m = (0.0, 0.0, 0.0)
    lab.fly(5.0)
    assert lab.set_mode(*mode) == [ACCEPTED, ACCEPTED]
    lab.fly(1.1)
    assert lab.last("HEARTBEAT").custom_mode == int(mode[0]) << 16 | int(mode[1]) << 24
    assert lab.arm() == [result]
    assert ("Using default takeoff altitude: 2.5 m" in lab.texts) is (mode == TAKEOFF)


def test_without_an_origin_take_off_never_becomes_hold_and_hold_is_acknowledged_only() -> None:
    lab = Laboratory(PX4)
    lab.fly(5.0)
    lab.set_mode(*TAKEOFF)
    lab.arm()
    lab.fly(10.0)
    assert lab.height_m == pytest.approx(2.5, abs=0.1)
    assert lab.set_mode(*LOITER) == [ACCEPTED, ACCEPTED]
    lab.fly(1.0)
    assert lab.vehicle.mode.value == TAKEOFF
    lab.set_origin(0.0)
    assert lab.set_mode(*LOITER) == [ACCEPTED, ACCEPTED]
    assert lab.vehicle.mode.value == LOITER


def test_without_an_origin_a_lost_stream_lands_in_place_of_hold() -> None:
    lab = hover(None, parameters={"COM_OBL_RC_ACT": 5})
    lab.goal_ned_m = None
    assert lab.until(lambda: lab.vehicle.mode.value == LAND, 2.0) == pytest.approx(1.06, abs=0.07)


def test_an_origin_gives_a_place_at_once_and_arming_after_3_9_s() -> None:
    lab = Laboratory(PX4)
    lab.fly(5.0)
    before = lab.local_ned_m
    lab.set_origin(0.0)
    lab.fly(0.05)
    assert len(lab.messages("GPS_GLOBAL_ORIGIN")) == 1
    assert lab.flags == 0x1FF
    place = lab.last("GLOBAL_POSITION_INT")
    assert (place.lat, place.lon) == pytest.approx((473977420, 85455940), abs=3)
    assert place.alt == pytest.approx(0, abs=30)
    assert lab.local_ned_m == pytest.approx(before, abs=0.01)
    assert lab.arm() == [LATER]
    assert UNSTABLE in lab.texts
    waited_s = lab.until(lambda: lab.command(M.MAV_CMD_COMPONENT_ARM_DISARM, 1.0) == [ACCEPTED], 6.0)
    assert waited_s + 0.15 == pytest.approx(3.9, abs=0.1)
    assert lab.command(M.MAV_CMD_REQUEST_MESSAGE, ORIGIN) == [ACCEPTED]


def test_its_flags_in_flight_and_near_the_ground() -> None:
    lab = hover()
    assert lab.flags == 0x17F
    lab.goal_ned_m = (0.0, 0.0, -0.2)
    lab.fly(4.0)
    assert lab.flags == 0x13F


# ---------------------------------------------------------------- vision is lost, and comes back


def test_dead_reckoning_is_shown_after_half_a_second_and_goes_on_for_ever() -> None:
    lab = hover()
    heard = len(lab.messages("LOCAL_POSITION_NED"))
    assert flags_change_s(lab, 127, 1.0) == pytest.approx(0.6, abs=0.1)
    lab.fly(0.4, pose_hz=0.0)
    accuracies_m = [lab.last("ESTIMATOR_STATUS").pos_horiz_accuracy]
    lab.fly(2.0, pose_hz=0.0)
    accuracies_m.append(lab.last("ESTIMATOR_STATUS").pos_horiz_accuracy)
    assert accuracies_m == pytest.approx([0.07, 0.6], abs=0.05)
    lab.fly(1.5, pose_hz=0.0)
    assert lab.flags == 127
    lab.fly(0.35, pose_hz=0.0)
    assert lab.flags == 101
    lab.fly(5.0, pose_hz=0.0)
    assert len(lab.messages("LOCAL_POSITION_NED")) - heard == pytest.approx(490, abs=10)
    assert lab.vehicle.mode.value == OFFBOARD
    assert not [text for text in lab.texts if "ailsafe" in text]


def test_without_vision_the_estimate_drifts_as_measured() -> None:
    lab, drifts_m = hover(), []
    for _ in range(10):
        lab.fly(1.0, pose_hz=0.0)
        drifts_m.append(lab.error_m)
    assert drifts_m[0] == pytest.approx(0.2, abs=0.08)
    assert drifts_m[2] == pytest.approx(0.6, abs=0.1)
    assert 0.5 < drifts_m[4] < 1.5
    assert 1.3 < drifts_m[9] < 6.6
    x, y, _ = lab.vehicle.quad.position_enu_m
    assert hypot(x, y) == pytest.approx(drifts_m[9], abs=0.3)  # the vehicle follows its estimate


@pytest.mark.parametrize(("gap_s", "step_m", "within_m"), [(0.5, 0.08, 0.05), (1.0, 0.15, 0.06), (3.0, 0.63, 0.07)])
def test_vision_that_is_back_makes_one_step_after_0_2_s(gap_s: float, step_m: float, within_m: float) -> None:
    lab = hover()
    lab.fly(gap_s, pose_hz=0.0)
    lab.fly(0.18)
    before = lab.local_ned_m
    lab.fly(0.06)
    after = lab.local_ned_m
    assert hypot(after[0] - before[0], after[1] - before[1]) == pytest.approx(step_m, abs=within_m)
    assert after == pytest.approx(lab.true_ned_m, abs=0.02)
    assert lab.flags == 0x17F


def test_a_gap_of_0_2_s_changes_nothing() -> None:
    lab = hover()
    for _ in range(5):
        lab.fly(0.18, pose_hz=0.0)
        lab.fly(0.5)
        assert lab.error_m < 0.01
        assert lab.flags == 0x17F


@pytest.mark.parametrize("mode", [LOITER, TAKEOFF])
def test_vision_lost_in_hold_lands_blind_and_holds_again_when_it_is_back(mode: tuple[float, float]) -> None:
    lab = hover()
    lab.set_mode(*TAKEOFF)
    if mode == LOITER:
        lab.fly(3.0)
        lab.set_mode(*LOITER)
    lab.fly(0.1)
    assert lab.until(lambda: lab.vehicle.mode.value == LAND, 6.0, 0.0) == pytest.approx(4.65, abs=0.1)
    lab.fly(0.2, pose_hz=0.0)
    assert "Failsafe activated" in lab.texts
    assert lab.vehicle.system_status == 5
    assert lab.until(lambda: lab.vehicle.mode.value == LOITER, 3.0) == pytest.approx(1.55, abs=0.35)
    assert lab.vehicle.system_status == 4


@pytest.mark.parametrize(("altitude_m", "stepped_m", "climbed_m"), [(0.0, 0.0, 0.0), (488.0, 488.0, 18.5)])
def test_a_restart_of_the_height_steps_by_the_altitude_of_the_origin(
    altitude_m: float, stepped_m: float, climbed_m: float
) -> None:
    lab = hover(altitude_m)
    origins, before, height_m = len(lab.messages("GPS_GLOBAL_ORIGIN")), lab.local_ned_m, lab.height_m
    lab.fly(0.5, pose_hz=0.0)
    lab.fly(0.3)
    assert lab.local_ned_m[2] - before[2] == pytest.approx(stepped_m, abs=0.7)
    lab.fly(5.0)
    assert lab.height_m - height_m == pytest.approx(climbed_m, abs=0.3 * climbed_m + 0.16)
    assert len(lab.messages("GPS_GLOBAL_ORIGIN")) == origins


# ---------------------------------------------------------------- wrong poses


def test_a_small_jump_is_followed_within_a_second() -> None:
    lab = hover()
    lab.shift_ned_m = (0.2, 0.0, 0.0)
    lab.fly(1.0)
    assert lab.error_m == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("jump_m", [0.5, 3.0])
def test_a_large_jump_is_rejected_for_1_16_s_then_one_step(jump_m: float) -> None:
    lab = hover()
    lab.shift_ned_m = (jump_m, 0.0, 0.0)
    assert lab.until(lambda: lab.error_m > 0.05, 2.0) == pytest.approx(1.16, abs=0.05)
    assert lab.error_m == pytest.approx(jump_m, abs=0.02)
    ratios = {round(m.pos_horiz_ratio, 1) for m in lab.messages("ESTIMATOR_STATUS")[-40:]}
    assert ratios == {2.0}
    assert lab.flags == 0x17F
    lab.fly(0.5)
    assert lab.last("ESTIMATOR_STATUS").pos_horiz_ratio == pytest.approx(0.1)


def test_a_jump_with_another_reset_counter_is_a_step_at_once() -> None:
    lab = hover()
    lab.shift_ned_m, lab.reset_counter = (2.0, 0.0, 0.0), 7
    lab.fly(0.02)
    assert lab.error_m == pytest.approx(2.0, abs=0.02)


def test_a_frozen_pose_is_followed() -> None:
    lab = hover()
    lab.frozen = True
    lab.fly(2.0)
    assert lab.error_m == pytest.approx(0.36, abs=0.05)
    assert lab.flags == 0x17F


def test_poses_at_10_hz_do_as_well() -> None:
    lab = hover()
    lab.fly(5.0, pose_hz=10.0)
    assert lab.error_m < 0.02
    assert lab.flags == 0x17F


@pytest.mark.parametrize(
    ("turn_deg", "seconds", "least_m", "most_m"),
    [(10.0, 5.0, 0.0, 0.6), (90.0, 3.0, 0.0, 0.6), (90.0, 5.0, 1.3, 12.0), (180.0, 3.0, 8.0, 30.0)],
)
def test_a_wrong_yaw_is_rejected_or_taken_in(turn_deg: float, seconds: float, least_m: float, most_m: float) -> None:
    """The noise is that of SIH: by 90 degrees 1.3 m then 4.2 m were measured, by 180 degrees 22 m."""
    lab, away_m = hover(sensors="px4_sih"), 0.0
    lab.turn_rad = radians(turn_deg)
    lab.fly(seconds)
    lab.turn_rad = 0.0
    for _ in range(50):
        lab.fly(0.1)
        x, y, _ = lab.vehicle.quad.position_enu_m
        away_m = max(away_m, hypot(x, y))
    assert least_m <= away_m <= most_m
    assert lab.flags == 0x17F


def test_a_moving_vehicle_is_placed_by_the_stamps_of_late_poses() -> None:
    """A pose that is 0.1 s old and says so."""
    lab = hover()
    lab.goal_ned_m = (6.0, 0.0, -2.0)
    waiting = []
    for step in range(500):
        if step % 5 == 0:
            waiting.append(lab.pose())
        if step >= 25 and step % 5 == 0:
            lab.send(waiting.pop(0))
        lab.fly(DT_S, pose_hz=0.0)
    assert lab.vehicle.quad.velocity_enu_m_s[1] > 1.0
    assert lab.error_m < 0.06


# ---------------------------------------------------------------- hostile poses

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize("value", [NAN, INF, -INF, 1e30, -3e38])
@pytest.mark.parametrize("field", ["x", "y", "z", "yaw"])
@pytest.mark.parametrize("message", ["VISION_POSITION_ESTIMATE", "ODOMETRY"])
def test_a_pose_that_is_none_is_not_used(message: str, field: str, value: float) -> None:
    lab = Laboratory(PX4, message)
    lab.fly(1.0)
    before = lab.local_ned_m
    for _ in range(100):
        pose = lab.pose()
        if field == "yaw" and message == "ODOMETRY":
            pose.q = [value, 0.0, 0.0, 0.0]
        else:
            setattr(pose, field, value)
        lab.send(pose)
        lab.fly(0.02, pose_hz=0.0)
    assert lab.local_ned_m == pytest.approx(before, abs=1.0)  # it dead-reckons
    assert lab.flags & 0x100 == 0
    lab.fly(0.5)
    assert lab.error_m < 0.02


def test_the_sender_of_a_pose_is_not_checked_and_odd_fields_do_no_harm() -> None:
    """As of commands: any system may send."""
    lab = Laboratory(PX4)
    for step in range(50):
        pose = lab.pose()
        pose.roll, pose.covariance, pose.usec = NAN, [INF] * 21, 2**64 - 1 if step % 2 else 0
        lab.send(pose, sender=(77, 13))
        lab.fly(0.02, pose_hz=0.0)
    assert lab.flags == 0x1EF


def test_an_odometry_of_another_frame_is_not_used() -> None:
    lab = Laboratory(PX4, "ODOMETRY")
    for _ in range(50):
        pose = lab.pose()
        pose.frame_id = M.MAV_FRAME_BODY_FRD
        lab.send(pose)
        lab.fly(0.02, pose_hz=0.0)
    assert lab.flags == 0xE5


def test_a_position_loss_of_the_scenario_keeps_poses_out() -> None:
    lab = Laboratory(PX4, position_losses=(PositionLoss(vehicle=1, at_s=2.0, until_s=3.0),))
    lab.fly(2.9)
    assert lab.flags & 0x100 == 0
    lab.fly(0.5)
    assert lab.flags == 0x1EF
