"""Whole flights in virtual time: the paper's platoon, the same to the last bit each time."""

import io
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from companion.types import FlightPhase
from sitl.metrics import FormationFigures, formation_figures, standing
from sitl.progress import Progress
from sitl.scenario import load_scenario, reference_of
from sitl.virtual_flight import Flown, fly_in_virtual_time

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
NOISY = "stand_in.sensors=default"
SHORT = "timeline[3].for_s=8"
BAD_NETWORK = ("links.peer_loss=0.1", "links.peer_delay_s=0.1")


@cache
def flown(*overrides: str) -> Flown:
    return fly_in_virtual_time(load_scenario(PLATOON, overrides), Progress("test", True, 0.0))


def again(*overrides: str) -> Flown:
    flown.cache_clear()
    return flown(*overrides)


@cache
def figures(*overrides: str) -> FormationFigures:
    flight = flown(*overrides)
    assert flight.failure is None
    assert flight.watch.formation is not None
    scenario = load_scenario(PLATOON, overrides)
    slots_enu_m = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    return formation_figures(flight.tracks(), standing(slots_enu_m), reference_of(scenario), flight.watch.formation)


def are_equal(one: Flown, other: Flown) -> bool:
    """To the last bit."""
    return all(
        np.array_equal(one.tracks()[i].position_enu_m, other.tracks()[i].position_enu_m)
        and np.array_equal(one.tracks()[i].time_s, other.tracks()[i].time_s)
        for i in one.tracks()
    )


# ---------------------------------------------------------------- the same again


@pytest.mark.parametrize("overrides", [(SHORT,), (SHORT, NOISY), (SHORT, NOISY, *BAD_NETWORK)])
def test_two_flights_of_one_scenario_are_identical(overrides: tuple[str, ...]) -> None:
    first = again(*overrides)
    second = again(*overrides)
    assert first is not second
    assert are_equal(first, second)
    assert first.watch.events == second.watch.events
    assert first.watch.formation == second.watch.formation
    assert first.flight_s == second.flight_s


def test_another_seed_is_another_flight() -> None:
    assert not are_equal(flown(SHORT, NOISY), flown(SHORT, NOISY, "stand_in.seed=2"))


def test_loss_and_delay_make_another_flight_and_the_platoon_bears_them() -> None:
    disturbed = flown(SHORT, *BAD_NETWORK)
    assert disturbed.failure is None
    assert not are_equal(flown(SHORT), disturbed)


# ---------------------------------------------------------------- the paper's figures


def test_the_weighted_law_keeps_the_platoon_closer_and_settles_sooner() -> None:
    weighted, *averages = (figures(f"fleet.law.name={law}") for law in ("weighted", "average_22", "average_26"))
    assert weighted.max_distance_m["1-2"] <= 1.90
    assert weighted.settle_s is not None
    assert weighted.final_error_m <= 0.05
    for average in averages:
        assert weighted.max_distance_m["1-2"] < average.max_distance_m["1-2"]
        assert average.settle_s is None or weighted.settle_s < average.settle_s


def test_without_lag_the_paper_s_figure_comes_out() -> None:
    ideal = figures(SHORT, "stand_in.airframe.attitude=instant", "stand_in.airframe.motor_lag_s=0")
    assert ideal.max_distance_m["1-2"] <= 1.76
    assert ideal.max_distance_m["1-2"] == pytest.approx(1.754, abs=0.02)


def test_with_sensor_noise_the_platoon_holds_together() -> None:
    noisy = figures(NOISY, "timeline[3].for_s=45")
    assert noisy.final_error_m <= 0.30
    assert min(noisy.min_distance_m.values()) >= 0.8


# ---------------------------------------------------------------- how it is flown


def test_the_timeline_is_flown_by_the_director_s_rules() -> None:
    flight = flown(SHORT)
    assert flight.failure is None
    assert figures(SHORT).duration_s == pytest.approx(8.0, abs=0.1)
    landed = [event.vehicle for event in flight.watch.events if event.event == "land -> observe"]
    assert sorted(landed) == [1, 2, 3, 4]
    assert flight.watch.timing == {}  # no tick is late in virtual time


def test_a_flight_that_cannot_begin_says_why() -> None:
    flight = fly_in_virtual_time(load_scenario(PLATOON, ["timeline[1].timeout_s=1"]), Progress("test", True, 0.0))
    assert flight.failure is not None
    assert flight.failure.startswith("arm not done within 1 s: vehicles 1, 2, 3, 4")
    assert flight.watch.formation is None


def test_followers_that_hear_nobody_are_handed_to_the_autopilot() -> None:
    flight = fly_in_virtual_time(load_scenario(PLATOON, [SHORT, "links.peer_loss=1"]), Progress("test", True, 0.0))
    assert flight.failure is not None
    assert "no leader's word" in flight.failure
    for vehicle_id in (1, 2, 3, 4):
        status = flight.watch.status(vehicle_id)
        assert status is not None
        assert not status.armed
        assert status.phase is FlightPhase.OBSERVE


def test_progress_is_in_virtual_time() -> None:
    shown = io.StringIO()
    fly_in_virtual_time(load_scenario(PLATOON, [SHORT]), Progress("platoon", False, 0.0, shown))
    assert "step 4 of 5, form   0." in shown.getvalue()
    assert "UAV 1   leader" in shown.getvalue()
