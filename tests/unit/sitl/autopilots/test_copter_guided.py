"""Attitude setpoints of the ArduCopter stand-in in GUIDED against measurements: thrust, timeout, masks, step response."""

from __future__ import annotations

from math import degrees, nan, radians

import pytest

from companion.geometry.frames import euler_from_quaternion, quaternion_from_euler
from companion.mavlink.codec import MavlinkMessage
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.autopilots.autopilot import AutopilotAbortedError
from sitl.vehicle.config import AutopilotFile, StandIn
from sitl.vehicle.control import AttitudeSetpoint
from sitl.vehicle.quadrotor import Quadrotor
from stand_ins import COPTER_DT_S, COPTER_HOVER, CopterOnBytes, M, attitude

WITHIN = 0.15


def guided(**parameters: float) -> CopterOnBytes:
    """A copter that hovers 5 m high in GUIDED."""
    copter = CopterOnBytes(**parameters)
    copter.take_off()
    return copter


def real_thrust() -> CopterOnBytes:
    return guided(GUID_OPTIONS=8)


def tilt_deg(copter: CopterOnBytes) -> float:
    roll, pitch, _ = euler_from_quaternion(copter.copter.quad.quaternion)
    return degrees(max(abs(roll), abs(pitch)))


def step_ms(axis: int, step_deg: float) -> tuple[dict[int, float], float]:
    """Milliseconds until 10, 50 and 90 % of a step, and the overshoot in degrees."""
    file = AutopilotFile(
        start_enu_m=(0.0, 0.0, 0.0), stand_in=StandIn(autopilot=AutopilotKind.ARDUPILOT, sensors="ideal")
    )
    quad = Quadrotor(file, ArduCopter.data.loops, COPTER_DT_S, ArduCopter.data.hover_thrust_norm)
    for _ in range(250):
        quad.step(AttitudeSetpoint(quaternion_from_euler(0.0, 0.0, 0.0), 0.6))
    angles = [0.0, 0.0, 0.0]
    angles[axis] = radians(step_deg)
    seen = []
    for _ in range(round(2.0 / COPTER_DT_S)):
        quad.step(AttitudeSetpoint(quaternion_from_euler(*angles), 0.6))
        seen.append(degrees(euler_from_quaternion(quad.quaternion)[axis]))
    passed = {
        share: next((i + 1) * COPTER_DT_S * 1000.0 for i, angle in enumerate(seen) if angle >= share / 100 * step_deg)
        for share in (10, 50, 90)
    }
    return passed, max(seen) - step_deg


@pytest.mark.parametrize("axis", [0, 1], ids=["roll", "pitch"])
def test_tilt_step_of_10_degrees(axis: int) -> None:
    passed, overshoot_deg = step_ms(axis, 10.0)
    assert passed == pytest.approx({10: 70.0, 50: 170.0, 90: 382.0}, rel=WITHIN)
    assert overshoot_deg < 0.05


def test_yaw_step_of_60_degrees() -> None:
    passed, overshoot_deg = step_ms(2, 60.0)
    assert passed[90] == pytest.approx(940.0, rel=WITHIN)
    assert overshoot_deg < 0.05


def test_thrust_is_thrust_and_hover_takes_0_365_when_bit_3_is_set() -> None:
    copter = real_thrust()
    copter.fly(2.0, attitude(thrust=COPTER_HOVER))
    assert abs(copter.climb_m_s) < 0.05
    copter.fly(0.5, attitude(thrust=1.0))
    assert copter.climb_m_s == pytest.approx(6.3, rel=0.3)
    copter.fly(0.2, attitude(thrust=5.0))
    assert copter.copter.setpoint.thrust_norm == 1.0


def test_thrust_is_a_climb_rate_by_default() -> None:
    copter = guided()
    for thrust, climb_m_s in ((0.5, 0.0), (0.7, 1.0), (0.4, -0.3)):
        copter.fly(3.0, attitude(thrust=thrust))
        assert copter.climb_m_s == pytest.approx(climb_m_s, abs=0.05)
    copter.fly(2.0, attitude(thrust=COPTER_HOVER))  # the thrust of a hover, here a descent
    assert copter.climb_m_s == pytest.approx(-0.41, abs=0.05)


def test_thrust_is_divided_by_the_cosine_of_the_tilt_and_reported_as_commanded() -> None:
    copter = real_thrust()
    copter.interval(M.MAVLINK_MSG_ID_ATTITUDE_TARGET, 50.0)
    copter.fly(1.0, attitude(30.0, 0.3))
    assert copter.copter.setpoint.thrust_norm == pytest.approx(0.3 / 0.866, rel=1e-3)
    assert copter.messages("ATTITUDE_TARGET")[-1].thrust == pytest.approx(0.3)
    copter.send(M.MAVLink_param_set_message(1, 1, b"ATC_ANGLE_BOOST", 0.0, 9))
    copter.fly(0.1, attitude(30.0, 0.3))
    assert copter.copter.setpoint.thrust_norm == pytest.approx(0.3)


def test_it_lifts_off_2_8_s_after_arming_by_thrust_alone() -> None:
    copter = CopterOnBytes(GUID_OPTIONS=8)
    copter.fly(0.1)
    copter.set_mode(CopterMode.GUIDED)
    copter.arm()
    armed_s = copter.copter.time_s
    while copter.height_m < 0.02:
        copter.fly(0.02, attitude(thrust=0.45))
    assert copter.copter.time_s - armed_s == pytest.approx(2.8, abs=0.2)


def test_the_last_attitude_is_kept_for_3_s_when_the_stream_ends() -> None:
    copter = real_thrust()
    copter.fly(0.4, attitude(8.0, 0.37))
    texts = len(copter.texts())
    copter.fly(2.9)
    assert tilt_deg(copter) == pytest.approx(8.0, abs=0.2)
    drift_m = abs(copter.copter.quad.position_enu_m[0])
    assert 4.0 < drift_m < 7.0
    copter.fly(1.5)
    assert tilt_deg(copter) < 0.5
    height_m = copter.height_m
    copter.fly(4.0)
    assert abs(copter.copter.quad.velocity_enu_m_s[0]) > 0.5
    assert abs(copter.copter.quad.position_enu_m[0]) > drift_m + 5.0
    assert copter.height_m == pytest.approx(height_m, abs=0.3)
    assert copter.copter.mode is CopterMode.GUIDED
    assert len(copter.texts()) == texts
    copter.fly(1.0, attitude(-8.0, 0.37))
    assert tilt_deg(copter) == pytest.approx(8.0, abs=0.5)  # the next setpoint is followed again


def test_the_attitude_is_kept_for_guid_timeout() -> None:
    copter = guided(GUID_OPTIONS=8, GUID_TIMEOUT=0.5)
    copter.fly(0.5, attitude(8.0))
    copter.fly(1.2)
    assert tilt_deg(copter) < 0.5


@pytest.mark.parametrize("mask", [7, 0])
def test_the_attitude_is_followed_with_usual_masks(mask: int) -> None:
    copter = real_thrust()
    copter.fly(1.0, attitude(10.0, mask=mask))
    assert tilt_deg(copter) == pytest.approx(10.0, abs=0.3)


def test_rates_are_followed_with_mask_0x80() -> None:
    copter = real_thrust()
    rates = M.MAVLink_set_attitude_target_message(0, 1, 1, 0x80, [0.0] * 4, 0.2, 0.0, 0.0, COPTER_HOVER)
    copter.fly(0.5, rates)
    assert 4.0 < tilt_deg(copter) < 7.0


def test_the_attitude_is_kept_when_attitude_and_rates_are_masked() -> None:
    copter = real_thrust()
    copter.fly(1.0, attitude(10.0))
    copter.fly(0.5, attitude(0.0, mask=0x87))
    assert tilt_deg(copter) == pytest.approx(10.0, abs=0.5)


@pytest.mark.parametrize(
    "message", [attitude(10.0, mask=3), attitude(10.0, mask=7 | 0x40), attitude(10.0, scale=1.0008)], ids=str
)
def test_it_brakes_when_the_setpoint_is_invalid(message: MavlinkMessage) -> None:
    copter = real_thrust()
    copter.fly(1.0, attitude(10.0))
    copter.send(message)
    copter.fly(5.0)
    position = copter.copter.quad.position_enu_m
    assert abs(copter.copter.quad.velocity_enu_m_s[0]) < 0.1
    copter.fly(3.0)
    assert copter.copter.quad.position_enu_m == pytest.approx(position, abs=0.1)
    assert copter.copter.mode is CopterMode.GUIDED


def test_the_autopilot_aborts_when_the_quaternion_is_nan() -> None:
    copter = real_thrust()
    with pytest.raises(AutopilotAbortedError):
        copter.send(M.MAVLink_set_attitude_target_message(0, 1, 1, 7, [nan] * 4, 0.0, 0.0, 0.0, COPTER_HOVER))


def test_a_tilt_past_angle_max_is_followed() -> None:
    copter = real_thrust()
    assert copter.copter.parameters["ANGLE_MAX"] == 3000
    copter.fly(1.0, attitude(40.0))
    assert tilt_deg(copter) == pytest.approx(40.0, abs=1.0)


@pytest.mark.parametrize(("target", "tilt"), [(0, 10.0), (1, 10.0), (2, 0.0)])
def test_only_the_target_system_of_a_setpoint_is_checked(target: int, tilt: float) -> None:
    copter = real_thrust()
    copter.fly(1.0, attitude(10.0, target=target))
    assert tilt_deg(copter) == pytest.approx(tilt, abs=0.3)


def test_setpoints_are_ignored_outside_guided_and_not_kept() -> None:
    copter = real_thrust()
    copter.set_mode(CopterMode.BRAKE)
    copter.fly(1.0, attitude(10.0))
    copter.set_mode(CopterMode.GUIDED)
    copter.fly(1.0)
    assert tilt_deg(copter) < 0.5


def test_positions_and_velocities_are_followed_and_a_velocity_ends_when_its_stream_ends() -> None:
    copter = guided()

    def target(mask: int, x: float = 0.0, vx: float = 0.0) -> MavlinkMessage:
        return M.MAVLink_set_position_target_local_ned_message(
            0, 1, 1, M.MAV_FRAME_LOCAL_NED, mask, x, 0.0, -5.0, vx, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        )

    copter.send(target(0xDF8, x=3.0))
    copter.fly(15.0)
    assert copter.copter.quad.position_enu_m == pytest.approx((0.0, 3.0, 5.0), abs=0.1)
    copter.fly(3.0, target(0xDC7, vx=1.0))
    assert copter.copter.quad.velocity_enu_m_s == pytest.approx((0.0, 1.0, 0.0), abs=0.1)
    copter.fly(6.0)
    assert copter.copter.quad.velocity_enu_m_s == pytest.approx((0.0, 0.0, 0.0), abs=0.1)
