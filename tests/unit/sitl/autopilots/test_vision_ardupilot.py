"""The ArduCopter stand-in with external vision in place of GPS, against measurements on ArduCopter 4.7: bytes in, bytes out."""

from __future__ import annotations

from itertools import pairwise
from math import hypot, radians

import pytest

from companion.mavlink.codec import mavlink as M  # noqa: N812 -- short, used in most lines
from laboratory import ARDUPILOT, Laboratory

ACCEPTED, FAILED = 0, 4
GUIDED, LAND, BRAKE = 4, 9, 17
FIELD_M = 488.0
ORIGIN, HOME = M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN, M.MAVLINK_MSG_ID_HOME_POSITION
USES_VISION = "EKF3 IMU0 is using external nav data"


def started(**stand_in: object) -> Laboratory:
    """One that takes little time to start."""
    return Laboratory(ARDUPILOT, **{"armable_after_s": 4.0} | stand_in)


def hover(**stand_in: object) -> Laboratory:
    """2 m above the ground in GUIDED."""
    lab = started(**stand_in)
    lab.fly(5.0)
    lab.set_origin(FIELD_M)
    assert lab.set_mode(GUIDED) == [ACCEPTED]
    assert lab.arm() == [ACCEPTED]
    assert lab.command(M.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 2.0) == [ACCEPTED]
    lab.fly(9.0)
    assert lab.height_m == pytest.approx(2.0, abs=0.1)
    assert lab.flags == 831
    return lab


# ---------------------------------------------------------------- without vision


def test_without_vision_it_reports_zeros_and_no_position() -> None:
    lab = Laboratory(ARDUPILOT)
    lab.fly(20.0, pose_hz=0.0)
    assert not lab.messages("LOCAL_POSITION_NED")
    places = lab.messages("GLOBAL_POSITION_INT")
    assert {(m.lat, m.lon, m.alt, m.relative_alt, m.vx, m.vy, m.vz) for m in places} == {(0,) * 7}
    gps = lab.last("GPS_RAW_INT")
    assert (gps.fix_type, gps.eph, gps.h_acc) == (0, 65535, 0)
    assert lab.flags == 167
    for wanted in (ORIGIN, HOME):
        before = len(lab.received)
        assert lab.command(M.MAV_CMD_REQUEST_MESSAGE, wanted) == [ACCEPTED]
        assert len(lab.received) == before + 1  # the answer alone
    lab.set_mode(GUIDED)
    assert lab.arm() == [FAILED]
    reasons = {"Arm: AHRS: waiting for home", "Arm: VisOdom: not healthy"}
    assert reasons | {"Arm: Gyros inconsistent"} <= set(lab.texts)
    lab.fly(4.0, pose_hz=0.0)
    lab.texts.clear()
    assert lab.arm() == [FAILED]
    assert {text for text in lab.texts if text.startswith("Arm: ")} == reasons


def test_its_parameters_say_so() -> None:
    vision, gps = Laboratory(ARDUPILOT), Laboratory(ARDUPILOT, positioning="gps")
    for name, by_vision, by_gps in (("VISO_TYPE", 1, 0), ("EK3_SRC1_YAW", 6, 1), ("GPS1_TYPE", 0, 1)):
        assert [lab.vehicle.parameters[name] for lab in (vision, gps)] == [by_vision, by_gps]


# ---------------------------------------------------------------- the first fix, and the origin


def test_the_first_fix_comes_5_5_s_after_the_start() -> None:
    lab = Laboratory(ARDUPILOT)
    lab.fly(8.0)
    assert lab.texts[USES_VISION] == pytest.approx(5.56, abs=0.05)


@pytest.mark.parametrize("message", ["VISION_POSITION_ESTIMATE", "ODOMETRY"])
def test_the_first_fix_comes_0_06_s_after_the_first_sample(message: str) -> None:
    lab = Laboratory(ARDUPILOT, message)
    lab.shift_ned_m = (1.5, -2.0, 0.25)
    lab.fly(7.0, pose_hz=0.0)
    assert lab.until(lambda: USES_VISION in lab.texts, 1.0) == pytest.approx(0.06, abs=0.03)
    lab.fly(0.04)
    assert lab.flags == 831
    assert lab.local_ned_m == pytest.approx((1.5, -2.0, 0.25), abs=0.02)
    assert lab.last("GLOBAL_POSITION_INT").lat == 0
    lab.set_mode(GUIDED)
    assert lab.arm() == [FAILED]
    assert "Arm: AHRS: waiting for home" in lab.texts
    assert "Arm: VisOdom: not healthy" not in lab.texts


def test_an_origin_gives_place_home_and_arming_at_once() -> None:
    lab = Laboratory(ARDUPILOT)
    lab.fly(25.0)
    lab.set_mode(GUIDED)
    assert lab.arm() == [FAILED]
    before = lab.local_ned_m
    lab.set_origin(FIELD_M)
    assert lab.arm() == [ACCEPTED]
    assert {"EKF3 IMU0 origin set", "Field Elevation Set: 488m"} <= set(lab.texts)
    assert len(lab.messages("GPS_GLOBAL_ORIGIN")) == len(lab.messages("HOME_POSITION")) == 1
    assert lab.last("GLOBAL_POSITION_INT").alt == pytest.approx(488_000, abs=50)
    assert lab.local_ned_m == pytest.approx(before, abs=0.01)
    lab.set_origin(0.0)
    assert lab.vehicle.quad.origin[2] == FIELD_M  # there is one


def test_the_prearm_bit_in_stabilize_does_not_wait_for_home() -> None:
    lab = started()
    lab.fly(5.0)
    assert lab.vehicle.armable
    lab.set_mode(GUIDED)
    assert not lab.vehicle.armable


def test_the_altitude_of_the_origin_must_be_that_of_the_field() -> None:
    lab = started()
    lab.fly(5.0)
    lab.set_origin(0.0)
    heights_m = []
    for _ in range(12):
        lab.fly(1.0)
        heights_m.append(-lab.local_ned_m[2])
    steps_m = [b - a for a, b in pairwise(heights_m)]
    assert steps_m[:6] == pytest.approx([0.125] * 6, abs=0.035)
    assert heights_m[-1] - lab.height_m == pytest.approx(0.94, abs=0.05)
    right = started()
    right.fly(5.0)
    right.set_origin(FIELD_M)
    right.fly(5.0)
    assert right.local_ned_m[2] == pytest.approx(0.0, abs=0.01)


# ---------------------------------------------------------------- vision is lost, and comes back


@pytest.mark.parametrize("mode", [GUIDED, BRAKE])
def test_a_loss_is_shown_after_7_s_and_lands_0_9_s_later(mode: int) -> None:
    lab = hover()
    lab.set_mode(mode)
    heard = len(lab.messages("LOCAL_POSITION_NED"))
    lab.fly(6.9, pose_hz=0.0)
    reports = lab.messages("EKF_STATUS_REPORT")[-340:]
    assert {(m.flags, m.pos_horiz_variance, m.velocity_variance) for m in reports} == {(831, 0.0, 0.0)}
    assert len(lab.messages("LOCAL_POSITION_NED")) - heard == pytest.approx(345, abs=3)
    assert lab.until(lambda: lab.flags == 37, 1.0, 0.0) + 6.9 == pytest.approx(7.0, abs=0.05)
    assert lab.until(lambda: lab.vehicle.mode == LAND, 2.0, 0.0) == pytest.approx(0.9, abs=0.05)
    lab.fly(0.1, pose_hz=0.0)
    assert {"EKF variance", "EKF Failsafe: changed to LAND Mode"} <= set(lab.texts)
    lab.fly(0.1)
    assert lab.flags == 831
    lab.fly(1.0)
    assert lab.vehicle.mode == LAND


def test_without_vision_the_estimate_drifts_as_measured() -> None:
    lab, drifts_m = hover(), []
    for _ in range(10):
        lab.fly(1.0, pose_hz=0.0)
        drifts_m.append(lab.error_m)
    assert [drifts_m[1], drifts_m[4], drifts_m[9]] == pytest.approx([0.05, 0.3, 1.4], rel=0.15)


def test_vision_that_is_back_makes_one_step_within_0_06_s() -> None:
    lab = hover()
    lab.fly(5.0, pose_hz=0.0)
    assert lab.error_m == pytest.approx(0.3, abs=0.05)
    assert lab.until(lambda: lab.error_m < 0.01, 0.5) <= 0.08
    lab.fly(0.1)
    assert lab.local_ned_m == pytest.approx(lab.true_ned_m, abs=0.05)
    assert lab.vehicle.mode == GUIDED


# ---------------------------------------------------------------- wrong poses


def test_a_jump_of_half_a_metre_is_followed_and_overshot() -> None:
    lab, errors_m = hover(), []
    lab.shift_ned_m = (0.5, 0.0, 0.0)
    for _ in range(50):
        lab.fly(0.02)
        errors_m.append(lab.error_m)
    assert max(errors_m) == pytest.approx(0.72, abs=0.02)
    lab.fly(4.0)
    assert lab.error_m == pytest.approx(0.5, abs=0.05)


def test_a_large_jump_is_rejected_for_2_9_s_then_followed_in_15_steps() -> None:
    lab = hover()
    lab.shift_ned_m = (3.0, 0.0, 0.0)
    assert lab.until(lambda: lab.error_m > 0.1, 5.0) == pytest.approx(2.9, abs=0.1)
    assert "EKF3 lane switch 1" in lab.texts
    errors_m = [lab.error_m]
    for _ in range(20):
        lab.fly(0.02)
        errors_m.append(lab.error_m)
    steps_m = [b - a for a, b in pairwise([0.0, *errors_m]) if b - a > 0.1]
    assert len(steps_m) == 15
    assert steps_m == pytest.approx([0.2] * 15, abs=0.05)
    assert lab.flags == 831


def test_a_jump_with_another_reset_counter_is_one_step_after_0_03_s() -> None:
    lab = hover()
    lab.shift_ned_m, lab.reset_counter = (3.0, 0.0, 0.0), 1
    assert lab.until(lambda: lab.error_m > 0.1, 1.0) == pytest.approx(0.03, abs=0.03)
    assert lab.error_m == pytest.approx(3.0, abs=0.05)


def test_a_frozen_pose_is_followed() -> None:
    lab = hover()
    lab.frozen = True
    lab.fly(2.0)
    assert lab.error_m == pytest.approx(0.17, abs=0.03)
    assert lab.flags == 831


@pytest.mark.parametrize(("turn_deg", "variance"), [(10.0, 0.28), (90.0, 2.5)])
def test_a_wrong_yaw_shows_in_the_variance_of_the_compass_alone(turn_deg: float, variance: float) -> None:
    lab = hover()
    lab.turn_rad = radians(turn_deg)
    lab.fly(0.1)
    assert max(m.compass_variance for m in lab.messages("EKF_STATUS_REPORT")[-5:]) == pytest.approx(variance, rel=0.1)
    lab.fly(4.9)
    lab.turn_rad = 0.0
    lab.fly(3.0)
    x, y, _ = lab.vehicle.quad.position_enu_m
    assert hypot(x, y) < 0.1
    assert lab.flags == 831


# ---------------------------------------------------------------- hostile poses


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e30])
@pytest.mark.parametrize("field", ["x", "z", "yaw"])
@pytest.mark.parametrize("message", ["VISION_POSITION_ESTIMATE", "ODOMETRY"])
def test_a_pose_that_is_none_is_not_used(message: str, field: str, value: float) -> None:
    lab = Laboratory(ARDUPILOT, message, armable_after_s=4.0)
    for _ in range(100):
        pose = lab.pose()
        if field == "yaw" and message == "ODOMETRY":
            pose.q = [value, 0.0, 0.0, 0.0]
        else:
            setattr(pose, field, value)
        lab.send(pose, sender=(9, 9))
        lab.fly(0.02, pose_hz=0.0)
    assert lab.flags == 167
    lab.fly(0.5)
    assert lab.error_m < 0.02


def test_an_odometry_of_other_frames_is_not_used() -> None:
    lab = Laboratory(ARDUPILOT, "ODOMETRY", armable_after_s=4.0)
    for frames in ((M.MAV_FRAME_LOCAL_NED, M.MAV_FRAME_BODY_FRD), (M.MAV_FRAME_LOCAL_FRD, M.MAV_FRAME_LOCAL_FRD)):
        for _ in range(50):
            pose = lab.pose()
            pose.frame_id, pose.child_frame_id = frames
            lab.send(pose)
            lab.fly(0.02, pose_hz=0.0)
    assert lab.flags == 167


@pytest.mark.parametrize("origin", [(473977420, 85455940, 2**31 - 1), (2**31 - 1, -(2**31), 0)])
def test_an_origin_that_is_not_in_this_world_is_not_used(origin: tuple[int, int, int]) -> None:
    lab = started()
    lab.fly(5.0)
    lab.send(M.MAVLink_set_gps_global_origin_message(1, *origin))
    lab.fly(0.1)
    assert not lab.messages("GPS_GLOBAL_ORIGIN")
