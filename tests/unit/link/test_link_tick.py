"""Histogram, tick meter and tick trigger."""

from __future__ import annotations

import asyncio
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.link.tick import (
    BACK_UP_S,
    LEAST_PERIOD_S,
    PERIOD_S,
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
        meter.command_sent(1.0 + n * PERIOD_S - 0.0005, 1.0 + n * PERIOD_S)
        meter.phase_after_tick(FlightPhase.FORMATION, 1.0 + n * PERIOD_S)
    in_formation = meter.timing(2.0)
    assert (in_formation.ticks, in_formation.missed) == (50, 0)
    assert in_formation.telemetry_to_command_us.max == pytest.approx(500.0, abs=1.0)

    meter.tick(2.02)
    meter.phase_after_tick(FlightPhase.RELEASE, 2.02)
    ended = meter.timing(2.02)
    ticks(meter, [5.0, 9.0])  # landing is another matter
    meter.command_sent(0.0, 9.0)
    meter.phase_after_tick(FlightPhase.LAND, 9.0)
    assert meter.timing(9.0) == ended
    assert ended.ticks == 51

    meter.phase_after_tick(FlightPhase.FORMATION, 10.0)
    meter.tick(10.02)
    assert meter.timing(10.02).ticks == 1


def test_position_triggers_the_tick_before_the_backup() -> None:
    async def scenario() -> tuple[float, float]:
        loop, trigger = asyncio.get_running_loop(), TickTrigger()
        start_s = loop.time()
        loop.call_later(0.001, trigger.position_arrived)
        await trigger.wait(start_s + 1.0)  # the back-up would come in a second
        by_position_s = loop.time() - start_s
        start_s = loop.time()
        await trigger.wait(start_s)
        return by_position_s, loop.time() - start_s

    by_position_s, by_timer_s = asyncio.run(scenario())
    assert by_position_s < 0.9
    assert by_timer_s >= BACK_UP_S * 0.99


def test_position_received_during_a_tick_triggers_the_next() -> None:
    async def scenario() -> float:
        loop, trigger = asyncio.get_running_loop(), TickTrigger()
        trigger.position_arrived()
        start_s = loop.time()
        await trigger.wait(start_s + 5.0)
        return loop.time() - start_s

    assert asyncio.run(scenario()) < 4.0


def test_a_flood_of_positions_triggers_few_ticks_more_than_the_nominal_rate() -> None:
    async def scenario() -> tuple[int, float]:
        loop, trigger, ticks = asyncio.get_running_loop(), TickTrigger(), 0
        start_s = now_s = loop.time()
        while now_s - start_s < 0.5:
            loop.call_soon(trigger.position_arrived)
            await trigger.wait(now_s)
            ticks, now_s = ticks + 1, loop.time()
        return ticks, now_s - start_s

    ticks, lasted_s = asyncio.run(scenario())
    assert ticks <= lasted_s * 61.0 + TICKS_AT_ONCE  # a second has 50 positions


def test_positions_that_were_delayed_trigger_ticks_at_once() -> None:
    async def scenario() -> list[float]:
        loop, trigger, waits_s = asyncio.get_running_loop(), TickTrigger(), []
        await trigger.wait(loop.time())  # nothing comes for BACK_UP_S
        for _ in range(TICKS_AT_ONCE - 1):
            trigger.position_arrived()
            start_s = loop.time()
            await trigger.wait(start_s + 1.0)
            waits_s.append(loop.time() - start_s)
        return waits_s

    assert min(asyncio.run(scenario())) < LEAST_PERIOD_S / 2


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
