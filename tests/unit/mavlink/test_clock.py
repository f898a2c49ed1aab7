"""How late the autopilot's samples arrive, by TIMESYNC and without it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.mavlink.clock import AutopilotClock
from companion.mavlink.codec import MavlinkCodec, mavlink
from companion.mavlink.translator import Translator
from companion.types.autopilot import AutopilotKind, PositionSample

BOOTED_S = 1000.0  # on this computer's clock


class Autopilot:
    """One that answers TIMESYNC and sends a position, `up_s` and `down_s` on the way. `slow`: the share its clock loses."""

    def __init__(self, slow: float = 0.0, answers: bool = True) -> None:
        self._clock, self._slow, self._answers = AutopilotClock(), slow, answers
        self._now_s = BOOTED_S + 5.0

    def falls_silent(self) -> None:
        """From now on it does not answer TIMESYNC."""
        self._answers = False

    def late_s(self, for_s: float, down_s: float, up_s: float = 0.001) -> float:
        """The largest age of a position in this time."""
        ages_s = [self._step(number, down_s, up_s) for number in range(round(for_s * 50))]
        return max(ages_s)

    def _step(self, number: int, down_s: float, up_s: float) -> float:
        self._now_s += 0.02
        if self._answers and number % 10 == 0:
            asked_ns = self._clock.request(self._now_s)
            answer_s = self._now_s + up_s
            self._clock.receive_answer(asked_ns, round(self._boot_s(answer_s) * 1e9), answer_s + down_s)
        return self._clock.late_s(self._boot_s(self._now_s), self._now_s + down_s)

    def _boot_s(self, now_s: float) -> float:
        return (now_s - BOOTED_S) * (1.0 - self._slow)


def test_a_constant_delay_is_measured_by_timesync() -> None:
    autopilot = Autopilot()
    autopilot.late_s(1.0, down_s=0.3)
    assert autopilot.late_s(30.0, down_s=0.3) == pytest.approx(0.3, abs=0.005)


def test_a_delay_of_requests_counts_too() -> None:
    autopilot = Autopilot()
    autopilot.late_s(1.0, down_s=0.01, up_s=0.2)
    assert autopilot.late_s(10.0, down_s=0.01, up_s=0.2) == pytest.approx(0.21, abs=0.005)


@pytest.mark.parametrize("answers", [True, False])
@given(slow=st.floats(-0.02, 0.02), down_s=st.floats(0.0, 0.08))
def test_a_clock_that_is_wrong_by_2_percent_is_no_delay(slow: float, down_s: float, answers: bool) -> None:
    assert Autopilot(slow, answers).late_s(8.0, down_s) == 0.0


@pytest.mark.parametrize("answers", [True, False])
@given(slow=st.floats(-0.02, 0.02))
def test_a_delay_that_grows_counts(slow: float, answers: bool) -> None:
    autopilot = Autopilot(slow, answers)
    assert autopilot.late_s(5.0, down_s=0.002) == 0.0
    assert autopilot.late_s(0.5, down_s=0.3) == pytest.approx(0.3, abs=0.07)


def test_with_timesync_a_delay_counts_as_long_as_it_lasts() -> None:
    autopilot = Autopilot()
    autopilot.late_s(5.0, down_s=0.002)
    autopilot.late_s(3.0, down_s=0.3)
    assert autopilot.late_s(60.0, down_s=0.3) == pytest.approx(0.3, abs=0.005)
    autopilot.late_s(3.0, down_s=0.002)
    assert autopilot.late_s(60.0, down_s=0.002) == 0.0


def test_after_a_reboot_nothing_of_the_old_clock_counts() -> None:
    clock = AutopilotClock()
    clock.exchange(100.0, 50.0, 100.001)
    assert clock.late_s(51.0, 101.3) == pytest.approx(0.3, abs=0.05)
    assert clock.late_s(1.0, 110.0) == 0.0
    assert clock.round_trip_s is None


def test_an_answer_by_another_clock_than_that_of_the_positions_is_ignored() -> None:
    clock = AutopilotClock()
    clock.late_s(51.0, 101.0)
    clock.receive_answer(clock.request(101.0), 1_800_000_000 * 10**9, 101.001)  # since 1970
    assert clock.round_trip_s is None
    assert clock.late_s(51.02, 101.02) == 0.0


def test_without_answers_for_long_a_delay_that_grows_counts_by_the_positions() -> None:
    autopilot = Autopilot()
    autopilot.late_s(3.0, down_s=0.002)
    autopilot.falls_silent()
    autopilot.late_s(60.0, down_s=0.002)
    assert autopilot.late_s(0.5, down_s=0.3) == pytest.approx(0.3, abs=0.02)


@given(ts1=st.integers(-(2**63), 2**63 - 1), tc1=st.integers(-(2**63), 2**63 - 1))
def test_an_answer_to_no_request_changes_nothing(ts1: int, tc1: int) -> None:
    translator = Translator(3, AutopilotKind.PX4)
    translator.time_request(10.0)
    sender = MavlinkCodec(3, 1)
    if ts1 == 10_000_000_000:
        return
    assert translator.telemetry(sender.encode(mavlink.MAVLink_timesync_message(tc1, ts1)), 10.5) == []
    assert translator.clock.round_trip_s is None


@given(tc1=st.integers(-(2**63), 2**63 - 1))
def test_whatever_time_an_answer_has_the_age_is_finite(tc1: int) -> None:
    translator = Translator(3, AutopilotKind.PX4)
    (request,) = MavlinkCodec(3, 1).decode(translator.time_request(10.0))
    sender = MavlinkCodec(3, 1)
    translator.telemetry(sender.encode(mavlink.MAVLink_timesync_message(tc1, request.ts1)), 10.5)
    position = mavlink.MAVLink_local_position_ned_message(1500, 1.0, 2.0, -3.0, 0.5, 0.25, -0.125)
    (sample,) = translator.telemetry(sender.encode(position), 11.0)
    assert isinstance(sample, PositionSample)
    assert 0.0 <= sample.late_s < 1e10


def test_the_agents_request_can_be_answered() -> None:
    translator = Translator(3, AutopilotKind.PX4)
    autopilot = MavlinkCodec(3, 1)
    translator.telemetry(autopilot.encode(mavlink.MAVLink_local_position_ned_message(1900, *6 * (0.0,))), 9.9)
    (request,) = autopilot.decode(translator.time_request(10.0))
    assert (request.get_type(), request.tc1) == ("TIMESYNC", 0)
    translator.telemetry(autopilot.encode(mavlink.MAVLink_timesync_message(2 * 10**9, request.ts1)), 10.4)
    assert translator.clock.round_trip_s == pytest.approx(0.4)
    position = mavlink.MAVLink_local_position_ned_message(2500, 1.0, 2.0, -3.0, 0.5, 0.25, -0.125)
    (sample,) = translator.telemetry(autopilot.encode(position), 10.9)
    assert isinstance(sample, PositionSample)
    assert sample.late_s == pytest.approx(0.39, abs=0.02)  # it left at 10.5 at the latest
