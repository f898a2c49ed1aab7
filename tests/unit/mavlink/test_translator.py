"""The translator with real MAVLink bytes in both directions."""

from math import cos, isnan, pi, sin

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink import px4
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import (
    AckSample,
    Arm,
    AttitudeSample,
    AttitudeTarget,
    AutopilotKind,
    AutopilotMode,
    Disarm,
    EstimatorSample,
    GlobalPositionSample,
    HeartbeatSample,
    HomeSample,
    LandedSample,
    LandedState,
    ModeSample,
    OriginSample,
    PositionAid,
    PositionSample,
    RallySample,
    RequestOrigin,
    SetMode,
    TakeOff,
    TextSample,
)
from companion.types.notices import Code
from sitl.autopilots.messages import MissionCurrent

AUTO_LOITER = (4 << 16) | (3 << 24)


def from_autopilot(message: object, system_id: int = 3, component_id: int = 1) -> bytes:
    return MavlinkCodec(system_id, component_id).encode(message)


def to_autopilot(data: bytes) -> object:
    (message,) = MavlinkCodec(3, 1).decode(data)
    return message


def test_position_is_converted_to_enu() -> None:
    data = from_autopilot(mavlink.MAVLink_local_position_ned_message(1500, 1.0, 2.0, -3.0, 0.5, 0.25, -0.125))
    assert Translator(3, AutopilotKind.PX4).telemetry(data, 9.0) == [
        PositionSample(9.0, 1.5, (2.0, 1.0, 3.0), (0.25, 0.5, 0.125))
    ]


def test_home_is_read() -> None:
    no = (0.0, 0.0, 0.0)
    message = mavlink.MAVLink_home_position_message(473977420, 85455940, 488000, *no, [1.0, *no], *no)
    samples = Translator(3, AutopilotKind.PX4).telemetry(from_autopilot(message), 9.0)
    assert samples == [HomeSample(9.0, 47.397742, 8.545594)]
    assert Translator(3, AutopilotKind.PX4).telemetry(from_autopilot(message, system_id=4), 9.0) == []


@pytest.mark.parametrize("rally_points_id", [0, 1, 0x01000000, 2**32 - 1])
@pytest.mark.parametrize("force_mavlink1", [False, True])
def test_rally_points_are_seen_by_their_id(rally_points_id: int, force_mavlink1: bool) -> None:
    """PX4 sends it with MAVLink 2, where zeros at the end of a message are left out."""
    data = MissionCurrent(rally_points_id).pack(mavlink.MAVLink(None, 3, 1), force_mavlink1)
    (sample,) = Translator(3, AutopilotKind.PX4).telemetry(data, 9.0)
    assert sample == RallySample(9.0, has_rally_points=rally_points_id != 0)


def test_attitude_is_converted_to_flu_in_enu() -> None:
    quaternion = quaternion_from_euler(0.1, 0.2, 0.3)  # FRD in NED
    data = from_autopilot(mavlink.MAVLink_attitude_quaternion_message(1500, *quaternion, 0, 0, 0))
    (sample,) = Translator(3, AutopilotKind.PX4).telemetry(data, 9.0)
    assert isinstance(sample, AttitudeSample)
    assert (sample.roll_rad, sample.pitch_rad, sample.yaw_rad) == pytest.approx((0.1, -0.2, pi / 2 - 0.3), abs=1e-5)


@pytest.mark.parametrize(
    ("text", "begins"),
    [
        ("Battery Failsafe", True),
        ("EKF variance", True),
        ("EKF Failsafe: changed to LAND Mode", True),
        ("EKF Failsafe Cleared", False),
        ("Battery 1 is low 10.50V used 900 mAh", True),
        ("Failsafe activated: switching to Land", True),
        ("Failsafe mode deactivated", False),
        ("Critical battery level, land now", True),
        ("PreArm: Battery failsafe", False),
        ("Low altitude", False),
    ],
)
def test_a_text_of_a_failsafe_that_begins_is_known(text: str, begins: bool) -> None:
    data = from_autopilot(mavlink.MAVLink_statustext_message(4, text.encode()))
    assert Translator(3, AutopilotKind.ARDUPILOT).telemetry(data, 9.0) == [TextSample(9.0, 4, text, begins)]


@pytest.mark.parametrize("quaternion", [(float("nan"), 0, 0, 0), (0, 0, 0, 0), (2, 0, 0, 0)])
def test_invalid_attitude_is_dropped_and_counted(quaternion: tuple[float, ...]) -> None:
    data = from_autopilot(mavlink.MAVLink_attitude_quaternion_message(1500, *quaternion, 0, 0, 0))
    translator = Translator(3, AutopilotKind.PX4)
    assert translator.telemetry(data, 9.0) == []
    assert translator.rejected == {Code.ATTITUDE_INVALID: 1}


def test_mode_and_armed_state_are_read() -> None:
    armed = mavlink.MAV_MODE_FLAG_SAFETY_ARMED | mavlink.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
    message = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_PX4, armed, AUTO_LOITER, 5, 3)
    assert Translator(3, AutopilotKind.PX4).telemetry(from_autopilot(message), 9.0) == [
        HeartbeatSample(9.0, armed=True, autopilot=AutopilotKind.PX4, critical=True),
        ModeSample(9.0, AutopilotMode.HOLD, "AUTO.LOITER"),
    ]
    current = mavlink.MAVLink_current_mode_message(0, 6 << 16, 6 << 16)
    assert Translator(3, AutopilotKind.PX4).telemetry(from_autopilot(current), 9.0) == [
        ModeSample(9.0, AutopilotMode.OFFBOARD, "OFFBOARD")
    ]


@pytest.mark.parametrize("mode", sorted(px4.MODES))
def test_every_commanded_mode_is_recognised(mode: AutopilotMode) -> None:
    message = to_autopilot(Translator(3, AutopilotKind.PX4).request(SetMode(mode)))
    custom_mode = int(message.param2) << 16 | int(message.param3) << 24  # type: ignore[attr-defined]
    assert px4.mode_of(custom_mode)[0] is mode


def test_pilot_mode_is_reported_as_other() -> None:
    assert px4.mode_of(3 << 16) == (AutopilotMode.OTHER, "POSCTL")
    assert px4.mode_of((4 << 16) | (4 << 24)) == (AutopilotMode.OTHER, "AUTO.MISSION")
    assert px4.mode_of(0)[0] is AutopilotMode.OTHER


def test_origin_landed_state_and_acknowledgements_are_read() -> None:
    data = (
        from_autopilot(mavlink.MAVLink_gps_global_origin_message(473977420, 85455940, 488123))
        + from_autopilot(mavlink.MAVLink_extended_sys_state_message(0, 2))
        + from_autopilot(mavlink.MAVLink_extended_sys_state_message(0, 77))
        + from_autopilot(mavlink.MAVLink_command_ack_message(400, 1))
        + from_autopilot(mavlink.MAVLink_command_ack_message(400, 0))
        + from_autopilot(mavlink.MAVLink_command_ack_message(65000, 99))
    )
    assert Translator(3, AutopilotKind.PX4).telemetry(data, 9.0) == [
        OriginSample(9.0, 47.397742, 8.545594, 488.123),
        LandedSample(9.0, LandedState.IN_AIR),
        LandedSample(9.0, LandedState.UNDEFINED),
        AckSample(9.0, (Arm, Disarm), False, "COMPONENT_ARM_DISARM temporarily rejected"),
        AckSample(9.0, (Arm, Disarm), True, "COMPONENT_ARM_DISARM accepted"),
        AckSample(9.0, (), False, "command 65000 result 99"),
    ]


def test_status_text_in_chunks_is_joined() -> None:
    translator = Translator(3, AutopilotKind.PX4)
    chunks = ["Arming denied: Resolve system health failures firs", "t\t"]
    samples = [
        sample
        for number, chunk in enumerate(chunks)
        for sample in translator.telemetry(
            from_autopilot(mavlink.MAVLink_statustext_message(2, chunk.encode(), 5, number)), 9.0
        )
    ]
    assert samples == [TextSample(9.0, 2, "Arming denied: Resolve system health failures first")]


@pytest.mark.parametrize("number", [0, 5])
def test_status_text_has_no_control_characters(number: int) -> None:
    message = mavlink.MAVLink_statustext_message(2, b"bad\nWATCHDOG=1\r\x1b[2J\xff ", number, 0)
    (sample,) = Translator(3, AutopilotKind.PX4).telemetry(from_autopilot(message), 9.0)
    assert isinstance(sample, TextSample)
    assert sample.text.startswith("bad?WATCHDOG=1??[2J")
    assert sample.text.isprintable()


def test_only_the_own_autopilot_is_decoded() -> None:
    translator = Translator(3, AutopilotKind.PX4)
    message = mavlink.MAVLink_local_position_ned_message(1500, 1, 2, 3, 0, 0, 0)
    assert translator.telemetry(from_autopilot(message, system_id=4), 9.0) == []
    assert translator.telemetry(from_autopilot(message, component_id=100), 9.0) == []
    assert str(translator.others) == "system 3, component 100, system 4, component 1"


def test_other_make_of_autopilot_is_counted_and_not_used() -> None:
    translator = Translator(3)
    message = mavlink.MAVLink_heartbeat_message(2, mavlink.MAV_AUTOPILOT_GENERIC, 0, 4, 4, 3)
    assert translator.telemetry(from_autopilot(message), 9.0) == []
    assert translator.refused_heartbeat == "HEARTBEAT reports MAV_AUTOPILOT 0, expected 12 (PX4) or 3 (ArduCopter)"
    assert translator.rejected == {Code.AUTOPILOT_OTHER_MAKE: 1}


def test_no_dialect_is_assumed_before_the_heartbeat() -> None:
    translator = Translator(3)
    current = mavlink.MAVLink_current_mode_message(0, 6 << 16, 6 << 16)
    assert translator.telemetry(from_autopilot(current), 9.0) == []
    with pytest.raises(LookupError):
        translator.request(Arm())


def test_attitude_target_is_encoded_in_ned() -> None:
    message = to_autopilot(
        Translator(3, AutopilotKind.PX4).attitude_target(AttitudeTarget(0.1, 0.2, pi / 2, 0.6), 12.5)
    )
    assert message.get_type() == "SET_ATTITUDE_TARGET"  # type: ignore[attr-defined]
    assert (message.target_system, message.target_component, message.type_mask) == (3, 1, 7)  # type: ignore[attr-defined]
    assert message.time_boot_ms == 12_500  # type: ignore[attr-defined]
    assert message.thrust == pytest.approx(0.6)  # type: ignore[attr-defined]
    # ENU yaw of 90 degrees is north: no yaw is left in NED; nose down is a negative pitch there.
    expected = (cos(0.05) * cos(-0.1), sin(0.05) * cos(-0.1), cos(0.05) * sin(-0.1), -sin(0.05) * sin(-0.1))
    assert message.q == pytest.approx(expected, abs=1e-6)  # type: ignore[attr-defined]


def test_commands_are_addressed_to_the_autopilot() -> None:
    translator = Translator(3, AutopilotKind.PX4)
    for request in (Arm(), TakeOff(2.5, 490.5), RequestOrigin()):
        message = to_autopilot(translator.request(request))
        assert (message.target_system, message.target_component) == (3, 1)  # type: ignore[attr-defined]
    takeoff = to_autopilot(translator.request(TakeOff(2.5, 490.5)))
    assert takeoff.param7 == pytest.approx(490.5)  # type: ignore[attr-defined]
    assert isnan(takeoff.param5)  # type: ignore[attr-defined]


def test_agent_heartbeat_is_not_of_a_ground_station() -> None:
    heartbeat = to_autopilot(Translator(3, AutopilotKind.PX4).heartbeat())
    assert heartbeat.type == mavlink.MAV_TYPE_ONBOARD_CONTROLLER  # type: ignore[attr-defined]


@given(st.binary(max_size=600))
def test_arbitrary_bytes_never_raise(data: bytes) -> None:
    translator = Translator(3, AutopilotKind.PX4)
    translator.telemetry(data, 1.0)
    translator.telemetry(b"\xfd" + data, 2.0)


@given(st.data())
def test_damaged_messages_never_raise(data: st.DataObject) -> None:
    good = bytearray(from_autopilot(mavlink.MAVLink_statustext_message(2, b"hello", 5, 0)))
    for _ in range(data.draw(st.integers(1, 5))):
        good[data.draw(st.integers(0, len(good) - 1))] = data.draw(st.integers(0, 255))
    Translator(3, AutopilotKind.PX4).telemetry(bytes(good), 1.0)


def test_acknowledgement_for_a_ground_station_is_ignored() -> None:
    def ack(to_system: int) -> bytes:
        return from_autopilot(mavlink.MAVLink_command_ack_message(mavlink.MAV_CMD_DO_SET_MODE, 4, 0, 0, to_system, 0))

    translator = Translator(3, AutopilotKind.PX4)
    assert translator.telemetry(ack(255), 1.0) == []
    assert len(translator.telemetry(ack(3) + ack(0), 1.0)) == 2


def test_position_error_is_read_from_estimator_or_gps_receiver() -> None:
    """PX4 sends the estimator's error, ArduCopter that of the GPS receiver; 0 is unknown."""
    estimator = from_autopilot(mavlink.MAVLink_estimator_status_message(0, 63, 0, 0, 0, 0, 0, 0, 0.25, 0.5))
    receiver, ignorant = (
        from_autopilot(mavlink.MAVLink_gps_raw_int_message(0, 3, 0, 0, 0, 90, 120, 0, 0, 14, 0, h_mm, v_mm))
        for h_mm, v_mm in ((300, 450), (0, 450))
    )
    px4_s, arducopter_s = Translator(3, AutopilotKind.PX4), Translator(3, AutopilotKind.ARDUPILOT)
    assert px4_s.telemetry(estimator + receiver, 9.0) == [EstimatorSample(9.0, 0.25, 0.5, aid=PositionAid.NOT_USED)]
    assert arducopter_s.telemetry(receiver, 9.0) == [EstimatorSample(9.0, 0.3, 0.45, aid=PositionAid.FIX)]
    (unknown,) = arducopter_s.telemetry(ignorant, 9.0)
    assert isinstance(unknown, EstimatorSample)
    assert isnan(unknown.horizontal_error_m)


def test_global_position_is_in_degrees_and_metres() -> None:
    message = mavlink.MAVLink_global_position_int_message(1500, 473977425, 85455941, 489250, 0, 0, 0, 0, 0)
    assert Translator(3).telemetry(from_autopilot(message), 9.0) == [
        GlobalPositionSample(9.0, 1.5, 47.3977425, 8.5455941, 489.25)
    ]
