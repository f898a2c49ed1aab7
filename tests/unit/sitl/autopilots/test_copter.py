"""The ArduCopter stand-in against measurements: streams, answers, arming, take-off and landing, links."""

from __future__ import annotations

from math import hypot, nan

import pytest

from companion.mavlink import ardupilot, telemetry
from companion.mavlink.codec import MavlinkCodec, mavlink
from sitl.autopilots.ardupilot.autopilot import ArduCopter
from sitl.autopilots.ardupilot.modes import CopterMode
from sitl.vehicle.automatic_flight import Course
from stand_ins import COPTER_DT_S, COPTER_HOVER, CopterOnBytes, M, attitude

ACCEPTED, DENIED, FAILED, UNSUPPORTED = 0, 2, 4, 3
ARM, TAKEOFF, REQUEST = M.MAV_CMD_COMPONENT_ARM_DISARM, M.MAV_CMD_NAV_TAKEOFF, M.MAV_CMD_REQUEST_MESSAGE


def test_only_heartbeats_and_texts_are_sent_without_requests() -> None:
    copter = CopterOnBytes()
    copter.fly(1.0)
    copter.received.clear()
    copter.fly(5.0)
    assert len(copter.messages("HEARTBEAT")) == 5
    assert {message.get_type() for message in copter.received} <= {"HEARTBEAT", "STATUSTEXT"}


@pytest.mark.parametrize(
    ("message_id", "kind"),
    [
        (M.MAVLINK_MSG_ID_HEARTBEAT, "HEARTBEAT"),
        (M.MAVLINK_MSG_ID_LOCAL_POSITION_NED, "LOCAL_POSITION_NED"),
        (M.MAVLINK_MSG_ID_ATTITUDE_TARGET, "ATTITUDE_TARGET"),
        (193, "EKF_STATUS_REPORT"),
    ],
)
def test_a_message_is_sent_at_exactly_50_hz_on_request(message_id: int, kind: str) -> None:
    copter = CopterOnBytes()
    copter.fly(1.0)
    assert copter.interval(message_id, 50.0) == ACCEPTED
    copter.received.clear()
    copter.fly(4.0)
    assert len(copter.messages(kind)) == 200


def test_too_fast_rates_and_unknown_messages_are_refused() -> None:
    copter = CopterOnBytes()
    assert copter.interval(M.MAVLINK_MSG_ID_ATTITUDE, 500.0) == DENIED
    for unknown in (M.MAVLINK_MSG_ID_CURRENT_MODE, M.MAVLINK_MSG_ID_ODOMETRY, M.MAVLINK_MSG_ID_ESTIMATOR_STATUS):
        assert copter.interval(unknown, 50.0) == DENIED
        assert copter.command(REQUEST, unknown) == FAILED
    copter.fly(0.1)
    assert "No ap_message for mavlink id (436)" in copter.texts()
    assert any("too fast" in text for text in copter.texts())


def test_every_command_has_one_answer_for_broadcast_and_unknown_components() -> None:
    copter = CopterOnBytes()
    copter.fly(0.1)
    assert copter.command(M.MAV_CMD_DO_SET_MODE, 1.0, 4, target=(0, 0)) == ACCEPTED
    assert copter.command(M.MAV_CMD_DO_SET_MODE, 1.0, 4, target=(1, 77)) == ACCEPTED
    assert copter.copter.mode is CopterMode.GUIDED
    assert copter.set_mode(99) == FAILED
    assert copter.command(31_999) == UNSUPPORTED
    padded = [1.0, 9.0, *[0.0] * 5]
    assert copter.send(M.MAVLink_command_long_message(2, 1, M.MAV_CMD_DO_SET_MODE, 0, *padded)) == []
    assert copter.copter.mode is CopterMode.GUIDED
    copter.fly(0.1)
    assert "No such mode 99" in copter.texts()


def test_defaults_are_the_measured_values() -> None:
    assert ArduCopter.data.armable_after_s == 42.0
    assert ArduCopter.data.hover_thrust_norm == COPTER_HOVER


def test_guided_is_accepted_before_arming_is_possible_and_reasons_are_sent() -> None:
    copter = CopterOnBytes(armable_after_s=42.0)
    texts = []
    copter.fly(3.0)
    assert copter.set_mode(CopterMode.GUIDED) == ACCEPTED
    while (result := copter.arm()) == FAILED:
        copter.fly(1.0)
        texts += copter.texts()
    assert result == ACCEPTED
    assert 41.0 < copter.copter.time_s < 44.0
    for reason in ("Accels inconsistent", "AHRS: waiting for home", "Need Position Estimate"):
        assert f"Arm: {reason}" in texts
    assert any(text.startswith("PreArm: ") for text in texts)


def test_sys_status_has_the_sensors_of_arducopter() -> None:
    """As recorded of ArduCopter 4.5 in SITL: before it can be armed, ready, and armed."""
    copter = CopterOnBytes(armable_after_s=5.0)
    copter.interval(M.MAVLINK_MSG_ID_SYS_STATUS, 10.0)
    seen = []
    for step in (lambda: None, lambda: copter.fly(6.0), copter.take_off):
        step()
        copter.fly(0.3)
        seen.append(copter.messages("SYS_STATUS")[-1])
    assert [(m.onboard_control_sensors_enabled, m.onboard_control_sensors_health) for m in seen] == [
        (0x52619C2F, 0x47719C2F),
        (0x52619C2F, 0x57719C2F),
        (0x5361FC2F, 0x5771FC2F),
    ]
    for status in seen:
        assert status.onboard_control_sensors_present == 0x5371FC2F
        assert telemetry.system(status, 0.0).estimator_healthy


def test_a_mode_set_before_initialisation_is_lost() -> None:
    copter = CopterOnBytes(armable_after_s=42.0)
    copter.fly(0.5)
    assert copter.set_mode(CopterMode.GUIDED) == ACCEPTED
    assert copter.arm() == FAILED
    copter.fly(3.0)
    assert copter.copter.mode is CopterMode.STABILIZE
    assert "Arm: System not initialised" in copter.texts()


@pytest.mark.parametrize("mode", [CopterMode.LAND, CopterMode.RTL, CopterMode.BRAKE, CopterMode.AUTO])
def test_arming_is_refused_in_modes_that_do_not_allow_it(mode: CopterMode) -> None:
    copter = CopterOnBytes()
    copter.fly(0.1)
    assert copter.set_mode(mode) == ACCEPTED
    assert copter.arm() == FAILED
    copter.fly(0.1)
    assert f"Arm: {mode.name} mode not armable" in copter.texts()


def test_position_origin_and_home_are_sent_when_known() -> None:
    copter = CopterOnBytes(armable_after_s=10.0)
    copter.interval(M.MAVLINK_MSG_ID_LOCAL_POSITION_NED, 50.0)
    assert copter.command(REQUEST, M.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN) == ACCEPTED
    copter.fly(4.0)
    assert not copter.messages("GPS_GLOBAL_ORIGIN")
    copter.fly(1.0)
    assert len(copter.messages("GPS_GLOBAL_ORIGIN")) == len(copter.messages("HOME_POSITION")) == 1
    assert not copter.messages("LOCAL_POSITION_NED")
    copter.fly(5.0)
    assert copter.messages("LOCAL_POSITION_NED")
    origin = copter.copter.quad.origin
    copter.send(M.MAVLink_set_gps_global_origin_message(1, 473977000, 85455000, 490_000))
    assert copter.copter.quad.origin == origin


def test_take_off_is_to_a_height_above_home_when_armed_in_guided() -> None:
    copter = CopterOnBytes()
    copter.fly(0.1)
    copter.set_mode(CopterMode.GUIDED)
    take_off = (TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
    assert copter.command(*take_off) == FAILED
    copter.set_mode(CopterMode.ALT_HOLD)
    copter.arm()
    assert copter.command(*take_off) == FAILED
    copter.set_mode(CopterMode.GUIDED)
    assert copter.command(*take_off) == ACCEPTED
    copter.fly(2.6)
    assert copter.height_m == 0.0
    copter.fly(6.0)
    assert copter.height_m == pytest.approx(3.0, abs=0.1)
    assert copter.copter.landed_state == M.MAV_LANDED_STATE_IN_AIR
    assert copter.command(*take_off) == FAILED  # it is in the air
    assert copter.command(ARM, 0.0) == FAILED


def test_take_off_is_delayed_by_the_spool_up_when_motors_idle() -> None:
    copter = CopterOnBytes()
    copter.fly(0.1)
    copter.set_mode(CopterMode.GUIDED)
    copter.arm()
    copter.fly(4.0)
    copter.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
    copter.fly(1.2)
    assert copter.height_m == 0.0
    copter.fly(0.6)
    assert copter.height_m > 0.05


def test_it_disarms_10_s_after_arming_without_take_off() -> None:
    copter = CopterOnBytes()
    copter.fly(0.1)
    copter.set_mode(CopterMode.GUIDED)
    copter.arm()
    copter.fly(9.8)
    assert copter.copter.armed
    copter.fly(0.4)
    assert not copter.copter.armed
    assert copter.copter.mode is CopterMode.GUIDED
    assert copter.texts()[-2:] == ["Arming motors", "Disarming motors"]


def test_it_lands_at_half_a_metre_per_second_and_disarms_2_s_after_touchdown() -> None:
    copter = CopterOnBytes()
    copter.take_off(3.0)
    assert copter.set_mode(CopterMode.LAND) == ACCEPTED
    copter.fly(2.0)
    assert copter.climb_m_s == pytest.approx(-0.5, abs=0.05)
    while not copter.copter.quad.on_ground:
        copter.fly(COPTER_DT_S)
    touched_s = copter.copter.time_s
    while copter.copter.armed:
        copter.fly(COPTER_DT_S)
    assert copter.copter.time_s - touched_s == pytest.approx(2.1, abs=0.2)
    assert copter.copter.mode is CopterMode.LAND


def test_negative_reported_thrust_is_read_as_zero_after_landing() -> None:
    copter = CopterOnBytes()
    copter.take_off(3.0)
    copter.set_mode(CopterMode.LAND)
    copter.interval(M.MAVLINK_MSG_ID_ATTITUDE_TARGET, 50.0)
    while copter.copter.armed:
        copter.fly(COPTER_DT_S)
    reported = [message for message in copter.messages("ATTITUDE_TARGET") if message.thrust < 0.0]
    assert 20 < len(reported) < 120
    assert {ardupilot.commanded_thrust(message.thrust, message.q) for message in reported} == {0.0}


def test_brake_holds_the_position_and_loiter_sinks_without_a_pilot() -> None:
    copter = CopterOnBytes(GUID_OPTIONS=8)
    copter.take_off()
    copter.fly(1.5, attitude(10.0))
    assert abs(copter.copter.quad.velocity_enu_m_s[0]) > 1.5
    assert copter.set_mode(CopterMode.BRAKE) == ACCEPTED
    copter.fly(6.0, attitude(10.0))  # ignored in BRAKE
    position = copter.copter.quad.position_enu_m
    copter.fly(20.0)
    assert copter.copter.quad.position_enu_m == pytest.approx(position, abs=0.05)
    assert copter.set_mode(CopterMode.LOITER) == ACCEPTED
    copter.fly(1.5)
    assert copter.climb_m_s < -1.5


def test_parameters_are_floats_by_value() -> None:
    copter = CopterOnBytes()
    (reported,) = copter.send(M.MAVLink_param_request_read_message(1, 1, b"GUID_OPTIONS", -1))
    assert (reported.param_value, reported.param_type) == (0.0, M.MAV_PARAM_TYPE_INT32)
    (reported,) = copter.send(M.MAVLink_param_set_message(1, 1, b"GUID_OPTIONS", 8.0, M.MAV_PARAM_TYPE_REAL32))
    assert reported.param_value == 8.0
    assert copter.copter.parameters["GUID_OPTIONS"] == 8
    (reported,) = copter.send(M.MAVLink_param_request_read_message(1, 1, b"MOT_THST_HOVER", -1))
    assert reported.param_value == pytest.approx(0.39)
    assert copter.send(M.MAVLink_param_request_read_message(1, 1, b"NO_SUCH", -1)) == []
    everything = copter.send(M.MAVLink_param_request_list_message(1, 1))
    assert {reported.param_index for reported in everything} == set(range(everything[0].param_count))


def test_rtl_begins_when_the_ground_station_is_lost_and_stays_when_it_is_back() -> None:
    copter = CopterOnBytes(FS_GCS_ENABLE=1)
    copter.take_off(3.0)
    copter.fly(8.0)
    assert copter.copter.mode is CopterMode.GUIDED  # a station without any heartbeat cannot be lost
    station = M.MAVLink_heartbeat_message(M.MAV_TYPE_GCS, M.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    copter.send(station)
    copter.fly(4.9)
    assert copter.copter.mode is CopterMode.GUIDED
    companion = MavlinkCodec(1, M.MAV_COMP_ID_ONBOARD_COMPUTER)
    copter.send(
        M.MAVLink_heartbeat_message(M.MAV_TYPE_ONBOARD_CONTROLLER, M.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3), companion
    )
    copter.fly(0.3)
    assert copter.copter.mode is CopterMode.RTL
    copter.send(station)
    copter.fly(0.5)
    assert copter.copter.mode is CopterMode.RTL
    assert copter.texts()[-2:] == ["GCS Failsafe", "GCS Failsafe Cleared"]


@pytest.mark.parametrize(
    ("distance_m", "highest_m"),
    [(0.0, 3.0), (4.0, 12.0), (8.0, 15.0)],  # from 3 m above home; measured 2.97, 12.05 and 14.99
)
def test_rtl_climbs_waits_above_home_and_lands_without_a_mode_change(distance_m: float, highest_m: float) -> None:
    copter = CopterOnBytes()
    copter.take_off(3.0)
    copter.copter.take_setpoint(Course((distance_m, 0.0, 3.0), (nan, nan, nan), nan, 0.0))
    copter.fly(8.0)
    assert copter.set_mode(CopterMode.RTL) == M.MAV_RESULT_ACCEPTED
    heights, waited_s = [], 0.0
    while copter.copter.landed_state != M.MAV_LANDED_STATE_LANDING:
        copter.fly(0.1)
        heights.append(copter.height_m)
        waited_s = waited_s + 0.1 if hypot(*copter.copter.quad.position_enu_m[:2]) < 0.5 else 0.0
        assert copter.copter.time_s < 60.0
    assert max(heights) == pytest.approx(highest_m, abs=0.3)
    assert waited_s == pytest.approx(5.0, abs=0.7)  # RTL_LOIT_TIME
    while copter.copter.armed:
        copter.fly(1.0)
        assert copter.copter.mode is CopterMode.RTL
        assert copter.copter.time_s < 90.0
    assert hypot(*copter.copter.quad.position_enu_m[:2]) < 0.1


def test_rtl_does_not_land_when_rtl_alt_final_is_above_zero() -> None:
    copter = CopterOnBytes(RTL_ALT_FINAL=400)
    copter.take_off(6.0)
    assert copter.set_mode(CopterMode.RTL) == M.MAV_RESULT_ACCEPTED
    copter.fly(30.0)
    assert copter.copter.armed
    assert copter.height_m == pytest.approx(4.0, abs=0.3)


def test_companion_heartbeats_are_not_needed() -> None:
    copter = CopterOnBytes()
    copter.take_off(3.0)
    copter.fly(20.0)
    assert copter.copter.mode is CopterMode.GUIDED
    assert copter.height_m == pytest.approx(3.0, abs=0.1)


def test_timesync_is_answered() -> None:
    copter = CopterOnBytes()
    copter.fly(2.0)
    (answer,) = copter.send(M.MAVLink_timesync_message(0, 12345))
    assert (answer.ts1, answer.tc1) == (12345, 2_000_000_000)


def test_unsigned_messages_are_dropped_and_answers_are_signed_when_signing_is_on() -> None:
    key = bytes(range(32))
    copter = CopterOnBytes()
    copter.fly(0.1)
    assert copter.send(M.MAVLink_setup_signing_message(1, 1, list(key), 10**12)) == []
    ask = M.MAVLink_param_request_read_message(1, 1, b"GUID_OPTIONS", -1)
    assert copter.send(ask) == []
    assert copter.send(ask, signed(bytes(32 * [7]), 10**12 + 10)) == []
    right = signed(key, 10**12 + 10)
    (reported,) = copter.send(ask, right)
    assert reported.get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED
    assert copter.send(ask, signed(key, 10**12 - 7_000_000)) == []  # more than a minute old
    copter.send(M.MAVLink_setup_signing_message(1, 1, [0] * 32, 0), right)
    (reported,) = copter.send(ask)
    assert not reported.get_msgbuf()[2] & mavlink.MAVLINK_IFLAG_SIGNED


class signed(MavlinkCodec):  # noqa: N801 -- reads as an adjective
    """A client that signs with pymavlink; its timestamps begin at `stamp`."""

    def __init__(self, key: bytes, stamp: int) -> None:
        super().__init__(255, 190)
        self._mav.signing.secret_key, self._mav.signing.timestamp = key, stamp
        self._mav.signing.sign_outgoing, self._mav.signing.link_id = True, stamp % 251
