"""Histogram, tick meter and tick trigger."""

from __future__ import annotations

import asyncio
import math
import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.link.tick import (
    BACK_UP_S,
    PERIOD_S,
    PREPARED_S,
    TICKS_AT_ONCE,
    Histogram,
    LateLoopLog,
    TickMeter,
    TickTrigger,
)
from companion.types.flight import FlightPhase
from companion.types.notices import Code, Notice


@given(st.lists(st.floats(min_value=2.0, max_value=1e7), min_size=1, max_size=300))
def test_percentiles_are_at_most_five_percent_too_high(values_us: list[float]) -> None:
    histogram = Histogram()
    for value_us in values_us:
        histogram.add(value_us)
    measured, exact = histogram.percentiles(), sorted(values_us)
    for fraction, got_us in ((0.50, measured.p50), (0.99, measured.p99)):
        true_us = exact[math.ceil(fraction * len(exact)) - 1]
        assert true_us - 0.1 <= got_us <= true_us * 1.0501 + 0.1
    assert measured.max == pytest.approx(exact[-1], abs=0.051)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=-1e12, max_value=1e12))
def test_every_time_has_a_bucket(value_us: float) -> None:
    histogram = Histogram()
    histogram.add(value_us)
    assert histogram.percentiles().p50 <= max(1.0, histogram.percentiles().max) + 1.0


def test_empty_histogram_returns_zero() -> None:
    assert Histogram().percentiles().max == 0.0
    assert Histogram().percentiles().p99 == 0.0


def ticks(meter: TickMeter, times_s: list[float]) -> None:
    for time_s in times_s:
        meter.tick(time_s)


def test_steady_loop_is_never_late() -> None:
    meter = TickMeter(0.0)
    ticks(meter, [n * PERIOD_S for n in range(501)])
    timing = meter.timing(10.0)
    assert timing.rate_hz == pytest.approx(50.0)
    assert (timing.ticks, timing.missed) == (501, 0)
    assert timing.late_us.max == pytest.approx(0.0, abs=0.1)
    assert timing.rss_mb > 1.0


def test_a_slow_second_is_found_in_the_rates_after_an_hour() -> None:
    meter, hour_s = TickMeter(0.0), 180_000 * PERIOD_S
    ticks(meter, [n * PERIOD_S for n in range(180_001)])
    before = meter.timing(hour_s)
    ticks(meter, [hour_s + n * 0.021 for n in range(1, 49)])
    after = meter.timing(hour_s + 1.1)
    elapsed_s = (after.ticks - 1) / after.rate_hz - (before.ticks - 1) / before.rate_hz
    assert elapsed_s == pytest.approx(48 * 0.021, abs=1e-4)


@pytest.mark.parametrize(
    ("interval_s", "missed", "late_us"),
    [(0.019, 0, 0), (0.0205, 0, 500), (0.029, 0, 9_000), (0.040, 1, 20_000), (0.061, 2, 41_000), (1.0, 49, 980_000)],
)
def test_long_interval_counts_as_late_and_as_missed_periods(interval_s: float, missed: int, late_us: float) -> None:
    meter = TickMeter(5.0)
    ticks(meter, [5.0, 5.0 + interval_s])
    timing = meter.timing(6.0)
    assert timing.missed == missed
    assert timing.late_us.max == pytest.approx(late_us, abs=1.0)


def test_backup_ticks_alone_miss_every_third_period() -> None:
    meter = TickMeter(0.0)
    ticks(meter, [n * BACK_UP_S for n in range(101)])
    assert meter.timing(3.0).missed == 50  # 150 periods, 100 ticks after the first


def test_missed_ticks_are_kept_and_jitter_is_not_counted() -> None:
    meter = TickMeter(0.0)
    ticks(meter, [n * PERIOD_S + (0.004 if n % 2 else 0.0) for n in range(50)])
    assert meter.timing(1.0).missed == 0
    meter.tick(1.98)  # 99 periods have gone by, 50 ticks came
    assert meter.timing(2.0).missed == 49
    ticks(meter, [1.98 + n * 0.005 for n in range(1, 100)])
    assert meter.timing(3.0).missed == 49


def test_timing_is_reset_at_the_start_of_formation() -> None:
    meter = TickMeter(0.0)
    ticks(meter, [0.0, 1.0])  # a bad start that must not count
    meter.phase_after_tick(FlightPhase.FORMATION, 1.0)
    for n in range(1, 51):
        meter.tick(1.0 + n * PERIOD_S)
        meter.add_command(1.0 + n * PERIOD_S - 0.0005, 1.0 + n * PERIOD_S)
        meter.phase_after_tick(FlightPhase.FORMATION, 1.0 + n * PERIOD_S)
    in_formation = meter.timing(2.0)
    assert (in_formation.ticks, in_formation.missed) == (50, 0)
    assert in_formation.telemetry_to_command_us.max == pytest.approx(500.0, abs=1.0)

    meter.tick(2.02)
    meter.phase_after_tick(FlightPhase.RELEASE, 2.02)
    ended = meter.timing(2.02)
    ticks(meter, [5.0, 9.0])  # landing is another matter
    meter.add_command(0.0, 9.0)
    meter.phase_after_tick(FlightPhase.LAND, 9.0)
    assert meter.timing(9.0) == ended
    assert ended.ticks == 51

    meter.phase_after_tick(FlightPhase.FORMATION, 10.0)
    meter.tick(10.02)
    assert meter.timing(10.02).ticks == 1


def test_timing_is_measured_once_a_second_after_the_first() -> None:
    meter = TickMeter(0.0)
    meter.tick(0.0)
    assert meter.timing(0.0).ticks == 1
    meter.tick(PERIOD_S)
    assert meter.timing(PERIOD_S).ticks == 2
    meter = TickMeter(0.0)
    ticks(meter, [n * PERIOD_S for n in range(100)])
    at_2_s = meter.timing(2.0)
    ticks(meter, [n * PERIOD_S for n in range(100, 150)])
    assert meter.timing(2.8) is at_2_s
    assert meter.timing(3.0).ticks == 150


class Calls:
    """Ticks and preparations of a trigger, with their times on the clock of the event loop."""

    def __init__(self) -> None:
        self.trigger = TickTrigger()
        self.began_s = time.monotonic()
        self.ticks_s: list[float] = []
        self.prepared_s: list[float] = []
        self.until_ticks = 1

    def tick(self) -> None:
        self.ticks_s.append(time.monotonic())
        if len(self.ticks_s) == self.until_ticks:
            self.trigger.end()

    def prepare(self) -> None:
        self.prepared_s.append(time.monotonic())

    async def run(self, until_ticks: int) -> None:
        self.until_ticks = len(self.ticks_s) + until_ticks
        async with asyncio.timeout(20.0):
            await self.trigger.run(self.tick, self.prepare)


def test_without_positions_a_timer_ticks() -> None:
    calls = Calls()
    asyncio.run(calls.run(4))
    for before_s, now_s in pairwise([calls.began_s, *calls.ticks_s]):
        assert now_s - before_s >= BACK_UP_S * 0.99


def test_a_position_ticks_within_the_call() -> None:
    async def scenario() -> list[int]:
        calls, ticks = Calls(), list[int]()

        def arrive() -> None:
            calls.trigger.position_arrived(time.monotonic())
            ticks.append(len(calls.ticks_s))

        asyncio.get_running_loop().call_soon(arrive)
        await calls.run(1)
        return ticks

    assert asyncio.run(scenario()) == [1]


def test_each_tick_is_prepared_once_shortly_before_the_next_position_is_expected() -> None:
    calls = Calls()
    asyncio.run(calls.run(4))
    assert len(calls.prepared_s) == 3
    for tick_s, prepared_s, next_s in zip(calls.ticks_s, calls.prepared_s, calls.ticks_s[1:], strict=False):
        assert tick_s + PERIOD_S - PREPARED_S <= prepared_s + 1e-4
        assert prepared_s <= next_s


def test_a_position_that_is_read_late_moves_no_preparation() -> None:
    """It was read 10 ms after its arrival: the next tick is prepared 8 ms after it, before what is due in 13 ms."""

    async def scenario() -> list[int]:
        calls, loop, prepared = Calls(), asyncio.get_running_loop(), list[int]()
        now_s = loop.time()
        loop.call_soon(calls.trigger.position_arrived, now_s - 0.01)
        loop.call_at(now_s + 0.013, lambda: prepared.append(len(calls.prepared_s)))
        await calls.run(2)
        return prepared

    assert asyncio.run(scenario()) == [1]


def test_a_position_that_comes_early_needs_no_preparation() -> None:
    async def scenario() -> Calls:
        calls, loop = Calls(), asyncio.get_running_loop()
        loop.call_soon(calls.trigger.position_arrived, time.monotonic())
        loop.call_soon(calls.trigger.position_arrived, time.monotonic())
        await calls.run(2)
        return calls

    assert asyncio.run(scenario()).prepared_s == []


def test_a_flood_of_positions_triggers_few_ticks_more_than_the_nominal_rate() -> None:
    async def scenario() -> Calls:
        calls, loop = Calls(), asyncio.get_running_loop()

        def flood() -> None:
            calls.trigger.position_arrived(time.monotonic())
            loop.call_soon(flood)

        loop.call_soon(flood)
        await calls.run(20)
        return calls

    calls = asyncio.run(scenario())
    lasted_s = calls.ticks_s[-1] - calls.began_s
    assert len(calls.ticks_s) <= lasted_s * 61.0 + TICKS_AT_ONCE  # 60 Hz, and 1 for the rounding of timers


def test_positions_that_were_delayed_trigger_ticks_at_once() -> None:
    async def scenario() -> list[int]:
        calls, ticks = Calls(), list[int]()

        def arrive() -> None:
            for _ in range(TICKS_AT_ONCE - 1):
                calls.trigger.position_arrived(time.monotonic())
                ticks.append(len(calls.ticks_s))

        asyncio.get_running_loop().call_later(1.5 * BACK_UP_S, arrive)  # after a tick without them
        await calls.run(TICKS_AT_ONCE)
        return ticks

    assert asyncio.run(scenario()) == [2, 3]


def test_after_the_end_a_position_triggers_nothing() -> None:
    async def scenario() -> Calls:
        calls = Calls()
        await calls.run(1)
        calls.trigger.position_arrived(time.monotonic())
        return calls

    assert len(asyncio.run(scenario()).ticks_s) == 1


def test_late_cycles_are_logged_once_a_second_with_the_worst() -> None:
    reported: list[Notice] = []
    log = LateLoopLog(reported.append)
    for due_s, late_s in ((1.0, 0.019), (2.0, 0.05), (2.1, 0.03), (2.2, 0.4), (2.7, 0.0), (3.2, 0.0), (9.0, 0.0)):
        log.cycle(due_s, due_s + late_s)
    assert {notice.code for notice in reported} == {Code.LOOP_LATE}
    assert [notice.text for notice in reported] == [
        "1 cycles of the loop started late, at most 50 ms",
        "2 cycles of the loop started late, at most 400 ms",
    ]
