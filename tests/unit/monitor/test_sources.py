"""A replay: its clock, its speed, and jumps. The machine's clock is an argument."""

from __future__ import annotations

import pytest

from companion.monitor.events import Happening
from companion.monitor.sources import BEFORE_JUMP_S, ReplaySource
from companion.wire.messages import StatusReport
from ground_fleet import TIMING, leader, reported

REPORTS = [(1000.0 + k / 10, StatusReport(leader(), TIMING)) for k in range(301)]  # 30 s


class Clock:
    def __init__(self) -> None:
        self.now_s = 50.0

    def __call__(self) -> float:
        return self.now_s


@pytest.fixture
def clock() -> Clock:
    return Clock()


def times(source: ReplaySource) -> list[float]:
    return [time_s for time_s, _ in source.drain()]


def test_it_plays_at_the_speed_of_the_flight_and_stops_at_its_end(clock: Clock) -> None:
    source = ReplaySource(REPORTS, clock=clock)
    assert times(source) == [1000.0]
    clock.now_s += 2.0
    assert times(source) == [time_s for time_s, _ in REPORTS[1:21]]
    assert times(source) == []
    clock.now_s += 100.0
    assert len(times(source)) == 280
    assert source.replay.now_s == source.replay.end_s == 1030.0


def test_another_speed_does_not_jump(clock: Clock) -> None:
    source = ReplaySource(REPORTS, clock=clock)
    clock.now_s += 1.0
    source.set_speed(4.0)
    assert source.moment().time_s == pytest.approx(1001.0)
    clock.now_s += 1.0
    assert source.moment().time_s == pytest.approx(1005.0)
    source.set_speed(0.0)
    clock.now_s += 60.0
    assert source.replay.now_s == pytest.approx(1005.0)


@pytest.mark.parametrize(("asked_s", "found_s"), [(1010.0, 1010.0), (0.0, 1000.0), (9999.0, 1030.0)])
def test_a_jump_reads_a_little_of_what_was_before(clock: Clock, asked_s: float, found_s: float) -> None:
    source = ReplaySource(REPORTS, clock=clock)
    clock.now_s += 20.0
    source.drain()
    source.seek(asked_s)
    played = times(source)
    assert source.moment().time_s == pytest.approx(found_s)
    assert found_s - BEFORE_JUMP_S - 0.11 <= played[0] <= max(1000.0, found_s - BEFORE_JUMP_S)
    assert played[-1] == found_s


def test_after_a_jump_a_vehicle_that_was_lost_long_before_is_known(clock: Clock) -> None:
    lost = (1000.05, StatusReport(reported(2), TIMING))
    source = ReplaySource([REPORTS[0], lost, *REPORTS[1:]], clock=clock)
    source.seek(1020.0)
    played = source.drain()
    assert played[:2] == [lost, (1017.9, REPORTS[179][1])]
    assert source.drain() == []
    source.seek(1000.0)
    assert [time_s for time_s, _ in source.drain()] == [1000.0]


def test_commands_and_answers_are_played_at_their_times_and_again_after_a_jump(clock: Clock) -> None:
    done = [Happening(1000.0 + t, "platoon", 1, "command", "hold", "anna: hold") for t in (5.0, 10.0)]
    source = ReplaySource(REPORTS, done, clock)
    clock.now_s += 6.0
    assert source.drain_happenings() == done[:1]
    clock.now_s += 6.0
    assert source.drain_happenings() == done[1:]
    assert source.drain_happenings() == []
    source.seek(1005.5)
    assert source.drain_happenings() == done[:1]
