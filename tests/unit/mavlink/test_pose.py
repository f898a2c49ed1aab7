"""Motion-capture poses and origins to the autopilot, decoded by pymavlink: frames, covariance, stamps of its own clock."""

from __future__ import annotations

from math import asin, atan2
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymavlink.dialects.v20 import ardupilotmega

from companion.geometry.frames import quaternion_from_euler
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.translator import ANSWERS_KEPT, Translator, pose_covariance
from companion.types.autopilot import AutopilotKind, SetOrigin
from companion.types.peers import BodyPose
from companion.types.values import Vector3

BOOTED_S = 1000.0  # on this computer's clock
COVARIANCE = pose_covariance(0.01, 0.02)
LEVEL = (1.0, 0.0, 0.0, 0.0)


def decoded(data: bytes) -> Any:
    (message,) = ardupilotmega.MAVLink(None).parse_buffer(data)
    return message


def sent(
    translator: Translator, measured_s: float = BOOTED_S, position: Vector3 = (1.0, 2.0, 3.0), resets: int = 0
) -> Any:
    return decoded(translator.pose(BodyPose(7, 1, 0.0, position, LEVEL), measured_s, COVARIANCE, resets))


def hear(translator: Translator, message: Any, received_s: float) -> None:
    translator.telemetry(MavlinkCodec(3, 1).encode(message), received_s)


def hear_position(translator: Translator, boot_s: float, received_s: float) -> None:
    hear(translator, mavlink.MAVLink_local_position_ned_message(round(boot_s * 1e3), 0, 0, 0, 0, 0, 0), received_s)


def exchange(translator: Translator, asked_s: float, boot_s: float, received_s: float) -> None:
    """A request of this computer, which the autopilot answers."""
    request = decoded(translator.time_request(asked_s))
    assert request.tc1 == 0
    hear(translator, mavlink.MAVLink_timesync_message(round(boot_s * 1e9), request.ts1), received_s)


def test_position_covariance_and_counter_of_resets() -> None:
    message = sent(Translator(3), position=(1.0, 2.0, 3.0), resets=257)
    assert message.get_type() == "VISION_POSITION_ESTIMATE"
    assert (message.get_srcSystem(), message.x, message.y, message.z) == (3, 2.0, 1.0, -3.0)
    assert message.reset_counter == 1  # one byte
    # Rows of the upper triangle begin here: x, y, z, then roll, pitch, yaw
    expected = dict.fromkeys((0, 6, 11), 0.01**2) | dict.fromkeys((15, 18, 20), 0.02**2)
    assert message.covariance == pytest.approx([expected.get(place, 0.0) for place in range(21)])


angles = st.floats(-3.1, 3.1)


@given(roll_rad=angles, pitch_rad=st.floats(-1.5, 1.5), yaw_rad=angles)
def test_the_angles_turn_the_same_body(roll_rad: float, pitch_rad: float, yaw_rad: float) -> None:
    """By where the nose and the left side of the body point, in east, north, up and in north, east, down."""
    w, x, y, z = quaternion = quaternion_from_euler(roll_rad, pitch_rad, yaw_rad)
    nose_enu = (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y))
    left_up, body_up = 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    message = decoded(Translator(3).pose(BodyPose(7, 1, 0.0, (0.0, 0.0, 0.0), quaternion), 0.0, COVARIANCE, 0))
    assert message.yaw == pytest.approx(atan2(nose_enu[0], nose_enu[1]), abs=1e-4)  # from north towards east
    assert message.pitch == pytest.approx(asin(nose_enu[2]), abs=1e-3)  # nose up
    assert message.roll == pytest.approx(atan2(left_up, body_up), abs=1e-4)  # right side down, so left side up


@pytest.mark.parametrize("exchanges", [True, False])
def test_the_stamp_is_the_time_of_measuring_by_the_autopilots_clock(exchanges: bool) -> None:
    translator = Translator(3)
    for number in range(60):
        now_s = BOOTED_S + 5.0 + 0.02 * number
        late_s = 0.3 if exchanges else 0.001  # known by answers alone
        hear_position(translator, now_s - BOOTED_S, now_s + late_s)
        if exchanges and number % 10 == 0:
            exchange(translator, now_s, now_s + 0.001 - BOOTED_S, now_s + late_s)
    assert sent(translator, BOOTED_S + 6.15).usec == pytest.approx(6_150_000, abs=1_500)


def test_the_stamp_follows_an_autopilot_that_has_rebooted() -> None:
    translator = Translator(3)
    for number in range(2):
        hear_position(translator, 500.0 + number, 1500.0 + number)
        exchange(translator, 1500.5 + number, 500.5 + number, 1500.501 + number)
    assert sent(translator, 1502.0).usec == pytest.approx(502_000_000, abs=2_000)
    hear_position(translator, 2.0, 1510.0)
    assert sent(translator, 1510.0).usec == pytest.approx(2_000_000, abs=2_000)
    exchange(translator, 1510.1, 2.1, 1510.101)
    assert sent(translator, 1511.0).usec == pytest.approx(3_000_000, abs=2_000)


def test_the_stamp_is_right_before_the_first_position() -> None:
    """ArduCopter sends no position before it has used a pose, and the cameras may start late."""
    translator = Translator(3)
    for number in range(0, 200, 20):
        exchange(translator, BOOTED_S + number, float(number), BOOTED_S + number + 0.001)
    assert sent(translator, BOOTED_S + 190.0).usec == pytest.approx(190_000_000, abs=2_000)
    hear_position(translator, 191.0, BOOTED_S + 191.001)
    assert sent(translator, BOOTED_S + 192.0).usec == pytest.approx(192_000_000, abs=2_000)


def test_the_first_position_shows_that_the_answers_before_it_are_of_another_clock() -> None:
    translator = Translator(3)
    exchange(translator, BOOTED_S, 1_800_000_000.0, BOOTED_S + 0.001)
    hear_position(translator, 5.0, BOOTED_S + 5.0)
    assert sent(translator, BOOTED_S + 5.5).usec == pytest.approx(5_500_000, abs=2_000)


def test_the_stamp_is_not_in_the_future_when_answers_cease() -> None:
    """The clock of PX4 runs 1 to 2 % slow: the smallest difference of a minute ago is no guess of the present one."""
    translator, ahead_us = Translator(3), []
    for number in range(75 * 50):
        now_s, boot_s = BOOTED_S + 0.02 * number, 0.99 * 0.02 * number
        hear_position(translator, boot_s, now_s + 0.001)
        if number % 10 == 0 and 1.0 < now_s - BOOTED_S < 60.0:
            exchange(translator, now_s, boot_s, now_s + 0.001)
        if now_s - BOOTED_S > 70.0:  # SILENT_S after the last answer
            ahead_us.append(sent(translator, now_s).usec - boot_s * 1e6)
    assert max(ahead_us) < 50_000


# ---------------------------------------------------------------- requests of the autopilot


def test_a_request_is_answered_by_the_autopilots_own_clock() -> None:
    translator = Translator(3)
    hear_position(translator, 5.0, BOOTED_S + 5.0)
    hear(translator, mavlink.MAVLink_timesync_message(0, 5_020_000_123), BOOTED_S + 5.021)
    answer = decoded(translator.answers.popleft())
    assert (answer.get_type(), answer.ts1) == ("TIMESYNC", 5_020_000_123)
    assert answer.tc1 == pytest.approx(5_021_000_000, abs=1_000_000)
    assert not translator.answers
    # It is the clock of the poses: a pose that is measured now has the stamp of the answer
    assert sent(translator, BOOTED_S + 5.021).usec == pytest.approx(answer.tc1 / 1e3, abs=1)


def test_a_request_is_not_answered_before_the_autopilots_clock_is_known() -> None:
    """An answer with the time 0 would be another request."""
    translator = Translator(3)
    hear(translator, mavlink.MAVLink_timesync_message(0, 5_020_000_123), BOOTED_S)
    assert not translator.answers


def test_a_flood_of_requests_is_bounded_and_the_newest_are_answered() -> None:
    translator, codec = Translator(3), MavlinkCodec(3, 1)
    hear_position(translator, 5.0, BOOTED_S + 5.0)
    flood = b"".join(codec.encode(mavlink.MAVLink_timesync_message(0, number)) for number in range(1, 1001))
    translator.telemetry(flood, BOOTED_S + 5.1)
    asked = [decoded(answer).ts1 for answer in translator.answers]
    assert asked == list(range(1001 - ANSWERS_KEPT, 1001))


def test_requests_of_others_are_not_answered() -> None:
    translator = Translator(3)
    hear_position(translator, 5.0, BOOTED_S + 5.0)
    for system_id, component_id in ((4, 1), (3, 191), (255, 190)):
        request = MavlinkCodec(system_id, component_id).encode(mavlink.MAVLink_timesync_message(0, 9))
        translator.telemetry(request, BOOTED_S + 5.1)
    assert not translator.answers


# ---------------------------------------------------------------- origins


@pytest.mark.parametrize(("kind", "altitude_mm"), [(AutopilotKind.PX4, 0), (AutopilotKind.ARDUPILOT, 488_123)])
def test_the_altitude_of_an_origin_is_that_which_the_autopilot_can_use(kind: AutopilotKind, altitude_mm: int) -> None:
    message = decoded(Translator(3, kind).request(SetOrigin(47.3977421, -8.5455938, 488.123)))
    assert message.get_type() == "SET_GPS_GLOBAL_ORIGIN"
    assert (message.target_system, message.latitude, message.longitude) == (3, 473_977_421, -85_455_938)
    assert message.altitude == altitude_mm
