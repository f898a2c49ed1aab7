"""When a battery is too low to stay in formation, and what is no reason to leave."""

from __future__ import annotations

import pytest

from companion.core.battery import LOW_FOR_S, BatteryWatch
from companion.types import FlightPhase, SystemSample


def told(watch: BatteryWatch, *percents: float, from_s: float = 10.0) -> str:
    """One sample a second."""
    for second, percent in enumerate(percents):
        watch.hear([SystemSample(from_s + second, percent, may_arm=True)])
    return watch.too_low


def test_it_is_too_low_when_it_stays_so() -> None:
    watch = BatteryWatch(15.0)
    assert told(watch, 20.0, *[14.0] * int(LOW_FOR_S)) == ""
    assert told(watch, 14.0, from_s=10.0 + 1.0 + LOW_FOR_S) == "battery at 14 %, below leave_below_percent 15"
    assert told(watch, 15.0, from_s=30.0) == ""


@pytest.mark.parametrize(
    ("below_percent", "percents"),
    [
        (15.0, [50.0, 2.0, 50.0, 50.0, 50.0, 2.0, 50.0]),  # single samples that are wrong
        (15.0, [2.0, 2.0, 2.0, 30.0, 2.0, 2.0, 2.0]),
        (15.0, [-1.0] * 20),
        (15.0, [2.0, 2.0, 2.0, -1.0, -1.0, -1.0]),
        (15.0, [float("nan")] * 20),
        (None, [1.0] * 20),
    ],
)
def test_what_is_no_reason_to_leave(below_percent: float | None, percents: list[float]) -> None:
    assert told(BatteryWatch(below_percent), *percents) == ""


def test_one_low_sample_that_is_the_last_is_not_a_low_battery_however_long_ago() -> None:
    watch = BatteryWatch(15.0)
    told(watch, 3.0)
    watch.hear([])
    assert watch.too_low == ""


def test_it_lands_out_of_the_hold_that_it_left_for_and_only_then() -> None:
    watch = BatteryWatch(15.0)
    assert not watch.must_land(FlightPhase.HOLD)
    watch.begin()
    assert not watch.must_land(FlightPhase.RELEASE)
    assert watch.must_land(FlightPhase.HOLD)
    watch.end()  # told something meanwhile
    assert not watch.must_land(FlightPhase.HOLD)
    watch.begin()
    assert not watch.must_land(FlightPhase.OBSERVE)  # a pilot took over
    assert not watch.must_land(FlightPhase.HOLD)
