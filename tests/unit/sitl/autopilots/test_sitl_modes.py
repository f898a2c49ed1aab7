"""Modes, arming and failsafes of the PX4 stand-in in virtual time, against measurements on PX4 v1.16."""

from __future__ import annotations

from itertools import pairwise
from math import hypot

import pytest

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import mavlink as M  # noqa: N812 -- short, used in most lines
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.px4.autopilot import NEED_A_PILOT, Px4Mode
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile
from sitl.vehicle.control import AttitudeSetpoint
from stand_ins import DT_S, LEVEL, Px4OnBytes

ACCEPTED, LATER, DENIED, UNSUPPORTED = 0, 1, 2, 3
ARM, SET_MODE, TAKEOFF = M.MAV_CMD_COMPONENT_ARM_DISARM, M.MAV_CMD_DO_SET_MODE, M.MAV_CMD_NAV_TAKEOFF
FORCE = 21196.0


def until(vehicle: Px4OnBytes, mode: Px4Mode, within_s: float, stream: AttitudeSetpoint | None = None) -> float:
    """Seconds until the vehicle is in `mode`."""
    for step in range(round(within_s / DT_S)):
        if vehicle.px4.mode is mode:
            return step * DT_S
        vehicle.fly(DT_S, stream)
    raise AssertionError(f"still {vehicle.px4.mode} after {within_s} s")


# ---------------------------------------------------------------- arming


def test_arming_is_accepted_about_4_s_after_the_start() -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(3.5)
    assert vehicle.results(ARM, 1.0) == [LATER]
    assert vehicle.texts() == ["Arming denied: Resolve system health failures first"]
    vehicle.fly(1.0)
    assert vehicle.results(ARM, 1.0) == [ACCEPTED]
    assert vehicle.px4.armed


def test_force_arms_at_once() -> None:
    vehicle = Px4OnBytes()
    assert vehicle.results(ARM, 1.0, FORCE) == [ACCEPTED]


def test_arming_is_denied_when_the_parameter_is_neither_0_nor_1() -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(4.2)
    assert vehicle.results(ARM, 0.5) == [DENIED]
    assert vehicle.results(ARM, float("nan")) == [DENIED]


@pytest.mark.parametrize(
    "mode", [Px4Mode.LAND, Px4Mode.RTL, Px4Mode.MISSION, Px4Mode.OFFBOARD, *sorted(NEED_A_PILOT, key=str)]
)
def test_modes_that_prevent_arming(mode: Px4Mode) -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(4.2)
    assert vehicle.set_mode(mode) == [ACCEPTED, ACCEPTED]  # disarmed, every mode is accepted
    assert vehicle.results(ARM, 1.0) == [LATER]
    vehicle.set_mode(Px4Mode.LOITER)
    assert vehicle.results(ARM, 1.0) == [ACCEPTED]


def test_it_lifts_off_when_armed_in_offboard() -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(4.2)
    climb = AttitudeSetpoint(LEVEL.quaternion, 0.65)
    vehicle.fly(0.5, climb)
    vehicle.set_mode(Px4Mode.OFFBOARD)
    assert vehicle.results(ARM, 1.0) == [ACCEPTED]
    vehicle.fly(0.3, climb)
    assert vehicle.height_m > 0.02
    assert vehicle.px4.landed_state == M.MAV_LANDED_STATE_IN_AIR


def test_it_disarms_after_10_s_without_take_off() -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(4.2)
    vehicle.results(ARM, 1.0)
    vehicle.fly(9.5)
    assert vehicle.px4.armed
    vehicle.fly(1.0)
    assert not vehicle.px4.armed


def test_disarming_in_the_air_needs_force() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    assert vehicle.results(ARM, 0.0) == [LATER]
    assert vehicle.texts()[-1] == "Disarming denied: not landed"
    assert vehicle.results(ARM, 0.0, FORCE) == [ACCEPTED]
    vehicle.fly(1.0)
    assert vehicle.height_m == pytest.approx(0.0, abs=0.1)


# ---------------------------------------------------------------- automatic modes


@pytest.mark.parametrize("armed_first", [True, False])
def test_take_off_of_1_m_is_settled_within_4_s(armed_first: bool) -> None:
    vehicle = Px4OnBytes()
    vehicle.fly(4.2)
    orders = [(ARM, (1.0,)), (TAKEOFF, (0.0,) * 6 + (vehicle.altitude_amsl_m + 1.0,))]
    for number, parameters in orders if armed_first else reversed(orders):
        assert vehicle.results(number, *parameters) == [ACCEPTED]
    assert vehicle.px4.mode is Px4Mode.TAKEOFF
    vehicle.fly(0.7)
    assert vehicle.px4.landed_state == M.MAV_LANDED_STATE_TAKEOFF
    vehicle.fly(3.3)
    assert vehicle.px4.mode is vehicle.px4.intended_mode is Px4Mode.LOITER
    for _ in range(20):
        assert vehicle.px4.quad.position_enu_m == pytest.approx((0.0, 0.0, 1.0), abs=0.01)
        vehicle.fly(0.5)


def test_take_off_is_to_mis_takeoff_alt_without_an_altitude() -> None:
    vehicle = Px4OnBytes(MIS_TAKEOFF_ALT=4.0)
    vehicle.fly(4.2)
    vehicle.results(ARM, 1.0)
    vehicle.results(TAKEOFF, *[float("nan")] * 7)
    vehicle.fly(8.0)
    assert vehicle.height_m == pytest.approx(4.0, abs=0.02)


def test_hold_brakes_and_keeps_the_position() -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    vehicle.fly(1.0, AttitudeSetpoint(quaternion_from_euler(0.0, 0.25, 0.0), 0.51))
    speed = vehicle.px4.quad.velocity_enu_m_s[0]
    assert speed > 1.0
    vehicle.set_mode(Px4Mode.LOITER)
    xs = [vehicle.px4.quad.position_enu_m[0]]
    for _ in range(60):
        vehicle.fly(0.1)
        xs.append(vehicle.px4.quad.position_enu_m[0])
    assert max(xs) - xs[-1] < 0.25  # it does not return to where hold began
    assert xs[-1] - xs[0] > 0.5
    assert max(abs(a - b) for a, b in pairwise(xs[-10:])) < 0.002


def test_landing_sinks_at_0_7_m_s_and_disarms_2_s_after_touchdown() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    assert vehicle.results(M.MAV_CMD_NAV_LAND) == [ACCEPTED]
    vehicle.fly(2.0)
    assert vehicle.px4.landed_state == M.MAV_LANDED_STATE_LANDING
    assert vehicle.px4.quad.velocity_enu_m_s[2] == pytest.approx(-0.7, abs=0.05)
    while vehicle.px4.landed_state != M.MAV_LANDED_STATE_ON_GROUND:
        vehicle.fly(DT_S)
    landed_s = vehicle.px4.time_s
    while vehicle.px4.armed:
        vehicle.fly(DT_S)
    assert vehicle.px4.time_s - landed_s == pytest.approx(2.0, abs=0.1)


def test_return_climbs_flies_home_and_lands_without_a_mode_change() -> None:
    vehicle = Px4OnBytes(RTL_RETURN_ALT=8.0)
    vehicle.offboard()
    vehicle.fly(5.0, AttitudeSetpoint(quaternion_from_euler(0.0, 0.2, 0.0), 0.50))
    assert vehicle.px4.quad.position_enu_m[0] > 10.0
    assert vehicle.results(M.MAV_CMD_NAV_RETURN_TO_LAUNCH) == [ACCEPTED]
    heights = []
    for _ in range(60):
        vehicle.fly(1.0)
        heights.append(vehicle.height_m)
        if not vehicle.px4.armed:
            break
        assert vehicle.px4.mode is Px4Mode.RTL
    assert max(heights) == pytest.approx(8.0, abs=0.6)
    assert vehicle.px4.quad.position_enu_m == pytest.approx((0.0, 0.0, 0.0), abs=0.7)
    assert vehicle.px4.mode is Px4Mode.OFFBOARD  # the last mode that allows arming


@pytest.mark.parametrize(
    ("distance_m", "highest_m"),
    [(0.0, 3.0), (4.0, 4.0), (8.0, 8.0), (12.0, 30.0)],  # from 3 m above home; measured 2.9, 4.0, 8.1 and 29.9
)
def test_return_climbs_less_when_home_is_near(distance_m: float, highest_m: float) -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off(3.0)
    assert vehicle.px4.go_to((distance_m, 0.0, 3.0), None)
    vehicle.fly(8.0)
    assert vehicle.set_mode(Px4Mode.RTL) == [ACCEPTED, ACCEPTED]
    heights = []
    while vehicle.px4.landed_state != M.MAV_LANDED_STATE_LANDING:
        vehicle.fly(0.1)
        heights.append(vehicle.height_m)
        assert vehicle.px4.time_s < 60.0
    assert max(heights) == pytest.approx(highest_m, abs=0.6)
    x, y, _ = vehicle.px4.quad.position_enu_m
    assert hypot(x, y) <= 2.0  # NAV_ACC_RAD: the landing begins within this radius of home
    vehicle.fly(0.1)
    assert vehicle.px4.mode is Px4Mode.RTL


@pytest.mark.parametrize(("delay_s", "lands"), [(3.0, True), (-1.0, False)])
def test_return_waits_at_rtl_descend_alt_and_does_not_land_with_a_negative_delay(delay_s: float, lands: bool) -> None:
    vehicle = Px4OnBytes(RTL_RETURN_ALT=8.0, RTL_DESCEND_ALT=5.0, RTL_LAND_DELAY=delay_s, RTL_CONE_ANG=0)
    vehicle.take_off(3.0)
    assert vehicle.set_mode(Px4Mode.RTL) == [ACCEPTED, ACCEPTED]
    vehicle.fly(8.0)
    assert vehicle.height_m == pytest.approx(5.0, abs=0.5)
    assert vehicle.px4.landed_state == M.MAV_LANDED_STATE_IN_AIR
    vehicle.fly(30.0)
    assert vehicle.px4.armed is not lands


def test_reposition_flies_to_the_latitude_and_altitude() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    north = vehicle.px4.quad.origin[0] + 3.0 / 111_170.0
    message = M.MAVLink_command_int_message(
        1, 1, M.MAV_FRAME_GLOBAL, M.MAV_CMD_DO_REPOSITION, 0, 0, -1.0, 1.0, 0.0, float("nan"),
        round(north * 1e7), 2**31 - 1, vehicle.altitude_amsl_m + 1.0,
    )  # fmt: skip
    assert [answer.result for answer in vehicle.send(message)] == [ACCEPTED]
    vehicle.fly(8.0)
    assert vehicle.px4.quad.position_enu_m == pytest.approx((0.0, 3.0, 3.5), abs=0.1)


def test_manual_modes_are_refused_in_the_air() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    for mode in sorted(NEED_A_PILOT, key=str):
        assert vehicle.set_mode(mode) == [ACCEPTED, LATER]
    assert vehicle.results(SET_MODE, 1.0, 99.0, 0.0) == [ACCEPTED, LATER]
    assert vehicle.results(SET_MODE, 1.0, float("nan"), 0.0) == [ACCEPTED, LATER]
    assert vehicle.px4.mode is Px4Mode.LOITER


# ---------------------------------------------------------------- OFFBOARD and the loss of its stream


def test_offboard_needs_a_stream_while_armed() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    assert vehicle.set_mode(Px4Mode.OFFBOARD) == [ACCEPTED, LATER]
    assert vehicle.px4.mode is Px4Mode.LOITER
    vehicle.fly(0.1, LEVEL)
    assert vehicle.set_mode(Px4Mode.OFFBOARD) == [ACCEPTED, ACCEPTED]
    assert vehicle.px4.mode is Px4Mode.OFFBOARD


@pytest.mark.parametrize("rate_hz", [4.0, 2.0, 1.25])
def test_offboard_is_kept_with_slow_streams(rate_hz: float) -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    for _ in range(8):
        vehicle.fly(1.0 / rate_hz, LEVEL, stream_hz=rate_hz)
        assert vehicle.px4.mode is Px4Mode.OFFBOARD


def test_the_mode_alternates_when_the_stream_is_below_1_hz() -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    modes = set()
    for step in range(round(8.0 / DT_S)):
        if step % round(1.0 / 0.9 / DT_S) == 0:
            vehicle.px4.take_setpoint(LEVEL)
        vehicle.fly(DT_S)
        modes.add(vehicle.px4.mode)
    assert modes == {Px4Mode.OFFBOARD, Px4Mode.POSCTL}


@pytest.mark.parametrize(
    ("action", "mode"),
    [
        (0, Px4Mode.POSCTL),
        (1, Px4Mode.ALTCTL),
        (2, Px4Mode.STABILIZED),
        (3, Px4Mode.RTL),
        (4, Px4Mode.LAND),
        (5, Px4Mode.LOITER),
    ],
)
def test_the_failsafe_mode_is_entered_when_the_stream_is_lost_and_left_when_it_is_back(
    action: int, mode: Px4Mode
) -> None:
    vehicle = Px4OnBytes(COM_OBL_RC_ACT=action)
    vehicle.offboard()
    last_setpoint_s = vehicle.px4.time_s - vehicle.px4.time_s % 0.02
    until(vehicle, mode, 1.5)
    assert 1.0 <= vehicle.px4.time_s - last_setpoint_s <= 1.12
    assert vehicle.px4.intended_mode is Px4Mode.OFFBOARD
    assert vehicle.px4.system_status == M.MAV_STATE_CRITICAL
    assert vehicle.texts()[-1] == "Failsafe activated"
    vehicle.fly(0.5)
    assert 0.03 <= until(vehicle, Px4Mode.OFFBOARD, 0.5, LEVEL) <= 0.055  # automatically
    assert vehicle.px4.system_status == M.MAV_STATE_ACTIVE


def test_it_sinks_and_drifts_in_position_mode_without_a_pilot() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off(6.0)
    vehicle.fly(0.2, LEVEL)
    vehicle.set_mode(Px4Mode.OFFBOARD)
    vehicle.fly(0.2, LEVEL)
    until(vehicle, Px4Mode.POSCTL, 1.5)
    x0, _, _ = vehicle.px4.quad.position_enu_m
    vehicle.fly(3.0)
    assert -1.0 < vehicle.px4.quad.velocity_enu_m_s[2] < -0.7
    assert vehicle.px4.quad.position_enu_m[0] - x0 > 0.2


def test_hold_keeps_the_position_within_half_a_metre_after_stream_loss() -> None:
    vehicle = Px4OnBytes(sensors="default", COM_OBL_RC_ACT=5)
    vehicle.offboard()
    until(vehicle, Px4Mode.LOITER, 1.5)
    position = vehicle.px4.quad.position_enu_m
    for _ in range(10):
        vehicle.fly(1.0)
        assert vehicle.px4.quad.position_enu_m == pytest.approx(position, abs=0.5)


@pytest.mark.parametrize("action", [6, 7])
def test_motors_stop_on_stream_loss_when_the_parameter_demands_it(action: int) -> None:
    vehicle = Px4OnBytes(COM_OBL_RC_ACT=action)
    vehicle.offboard()
    vehicle.fly(2.0)
    assert not vehicle.px4.armed
    assert vehicle.height_m == 0.0


def test_offboard_is_not_entered_again_when_another_mode_was_set() -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    until(vehicle, Px4Mode.POSCTL, 1.5)
    vehicle.set_mode(Px4Mode.LOITER)
    assert vehicle.px4.system_status == M.MAV_STATE_ACTIVE
    vehicle.fly(2.0, LEVEL)
    assert vehicle.px4.mode is Px4Mode.LOITER


# ---------------------------------------------------------------- OFFBOARD with positions and velocities


def follow(vehicle: Px4OnBytes, seconds: float, mask: int, *values: float, frame: int = M.MAV_FRAME_LOCAL_NED) -> None:
    """SET_POSITION_TARGET_LOCAL_NED at 20 Hz: x y z, vx vy vz, yaw."""
    numbers = (*values[:6], 0.0, 0.0, 0.0, values[6], 0.0)
    message = M.MAVLink_set_position_target_local_ned_message(0, 1, 1, frame, mask, *numbers)
    for step in range(round(seconds / 0.05)):
        vehicle.send(message)
        if step == 2:
            vehicle.set_mode(Px4Mode.OFFBOARD)
        vehicle.fly(0.05)


POSITION, VELOCITY = 0b1001_1111_1000, 0b1001_1100_0111


def test_offboard_flies_to_a_position_and_turns() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    follow(vehicle, 8.0, POSITION, 3.0, -2.0, -4.0, 0.0, 0.0, 0.0, 0.5)
    assert vehicle.px4.mode is Px4Mode.OFFBOARD
    assert vehicle.px4.quad.position_enu_m == pytest.approx((-2.0, 3.0, 4.0), abs=0.05)
    assert vehicle.px4.quad.estimated_euler_rad()[2] == pytest.approx(1.5707963 - 0.5, abs=0.01)


def test_offboard_follows_a_velocity_after_attitudes() -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()  # with attitudes
    follow(vehicle, 4.0, VELOCITY, 0.0, 0.0, 0.0, 1.0, 0.0, -0.5, 0.0)
    assert vehicle.px4.quad.velocity_enu_m_s == pytest.approx((0.0, 1.0, 0.5), abs=0.1)
    until(vehicle, Px4Mode.POSCTL, 1.5)  # this stream must continue, too


def test_a_course_in_another_frame_does_not_count_as_stream() -> None:
    vehicle = Px4OnBytes()
    vehicle.take_off()
    follow(vehicle, 0.5, VELOCITY, *[1.0] * 7, frame=M.MAV_FRAME_BODY_NED)
    follow(vehicle, 0.5, VELOCITY, *[float("nan")] * 7)
    assert vehicle.px4.mode is Px4Mode.LOITER


# ---------------------------------------------------------------- the ground station


def heartbeat_of(kind: int) -> object:
    return M.MAVLink_heartbeat_message(kind, M.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


def test_hold_then_return_are_entered_when_the_ground_station_is_lost() -> None:
    vehicle = Px4OnBytes(NAV_DLL_ACT=2, RTL_RETURN_ALT=4.0)
    vehicle.fly(4.2)
    assert vehicle.results(ARM, 1.0) == [LATER]  # a heartbeat of a ground station is required first
    vehicle.send(heartbeat_of(M.MAV_TYPE_ONBOARD_CONTROLLER))
    assert vehicle.results(ARM, 1.0) == [LATER]
    vehicle.send(heartbeat_of(M.MAV_TYPE_GCS))
    assert vehicle.results(ARM, 1.0) == [ACCEPTED]
    vehicle.results(TAKEOFF, *[float("nan")] * 7)
    vehicle.fly(5.0, LEVEL)
    vehicle.send(heartbeat_of(M.MAV_TYPE_GCS))
    vehicle.set_mode(Px4Mode.OFFBOARD)
    assert until(vehicle, Px4Mode.LOITER, 12.0, LEVEL) == pytest.approx(10.0, abs=0.15)  # COM_DL_LOSS_T
    assert vehicle.px4.system_status == M.MAV_STATE_CRITICAL
    assert until(vehicle, Px4Mode.RTL, 7.0, LEVEL) == pytest.approx(5.0, abs=0.15)  # COM_FAIL_ACT_T
    vehicle.send(heartbeat_of(M.MAV_TYPE_GCS))
    vehicle.fly(1.0, LEVEL)
    assert vehicle.px4.mode is Px4Mode.RTL  # neither the stream nor the heartbeat ends RTL
    assert vehicle.set_mode(Px4Mode.OFFBOARD) == [ACCEPTED, ACCEPTED]
    vehicle.fly(3.0, LEVEL)
    assert vehicle.px4.mode is Px4Mode.OFFBOARD


def test_a_lost_ground_station_is_ignored_by_default() -> None:
    vehicle = Px4OnBytes()
    vehicle.offboard()
    vehicle.send(heartbeat_of(M.MAV_TYPE_GCS))
    vehicle.fly(20.0, LEVEL)
    assert vehicle.px4.mode is Px4Mode.OFFBOARD


def test_the_last_mode_that_allows_arming_is_set_after_disarming() -> None:
    """After a formation this is OFFBOARD; arming is then refused until another mode is set."""
    vehicle = Px4OnBytes()
    vehicle.offboard()
    vehicle.set_mode(Px4Mode.LAND)
    vehicle.fly(15.0)
    assert not vehicle.px4.armed
    assert vehicle.px4.mode is Px4Mode.OFFBOARD
    assert vehicle.px4.arm() is not None
    assert vehicle.px4.set_mode(Px4Mode.LOITER)
    assert vehicle.px4.arm() is None


@pytest.mark.parametrize("kind", AUTOPILOT_TYPES)
def test_a_stand_in_has_fewer_than_30_attributes(kind: AutopilotKind) -> None:
    """CPython 3.11 keeps the first 30 attributes in the object; with one more, `sitl run` took 1.6 times as long."""
    assert len(vars(AUTOPILOT_TYPES[kind].vehicle(AutopilotFile(), DT_S))) < 30
