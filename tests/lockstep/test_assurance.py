"""Whole flights behind the last check of commands: it never acts where the filter is right, and acts where there is none."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from companion.core.filter.filter import NOTHING_SEEN, Filtered, SafetyFilter
from companion.core.safety.assurance import CommandMonitor
from companion.types.notices import Code
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import Flown, fly_without_landing
from sitl.report.progress import FlightProgress

HALF = 0.5  # of separation_m


def exchange() -> Scenario:
    """Four vehicles exchange their slots through the middle."""
    return load_scenario(Path("exchange"), ["stand_in.sensors=ideal"])


def flown(scenario: Scenario) -> Flown:
    return fly_without_landing(scenario, FlightProgress("test", True, 0.0))


def smallest_ratio(flight: Flown, scenario: Scenario) -> float:
    """Of two vehicles that agents command, in units of separation_m."""
    ratios = []
    for one, other in combinations(flight.stand_ins, 2):
        both = one.commanded() & other.commanded()
        apart_m = np.linalg.norm(one.track().position_enu_m - other.track().position_enu_m, axis=1)
        ratios.append(float(apart_m[both].min()) / scenario.fleet.separation_m)
    return min(ratios)


def braked(flight: Flown) -> int:
    statuses = [status for i in flight.watch.vehicle_ids if (status := flight.watch.status(i))]
    return sum(status.rejected.get(str(Code.COMMAND_BRAKED), 0) for status in statuses)


@pytest.fixture
def without_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    """The filter lets every command pass."""

    def passes(*given: object) -> Filtered:
        wanted_enu_m_s2 = given[6]
        return Filtered(wanted_enu_m_s2, NOTHING_SEEN)  # type: ignore[arg-type]

    monkeypatch.setattr(SafetyFilter, "step", passes)


def test_where_the_filter_is_right_it_never_acts() -> None:
    flight = flown(exchange())
    assert smallest_ratio(flight, exchange()) >= 1.0
    assert braked(flight) == 0


@pytest.mark.usefixtures("without_filter")
def test_without_the_filter_it_keeps_vehicles_at_half_of_the_separation() -> None:
    flight = flown(exchange())
    assert smallest_ratio(flight, exchange()) >= HALF
    assert braked(flight) > 0


@pytest.mark.usefixtures("without_filter")
def test_without_both_they_collide(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(CommandMonitor, "acceleration", lambda *given: given[4])
    assert smallest_ratio(flown(exchange()), exchange()) < 0.1
