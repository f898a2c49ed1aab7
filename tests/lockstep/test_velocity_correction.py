"""Autopilots whose velocity disagrees with their own position: where the vehicles rest, in truth."""

from __future__ import annotations

import numpy as np
import pytest

from common import ROOT
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_without_landing
from sitl.report.progress import FlightProgress

FOUR_IN_LINE = ROOT / "config" / "scenarios" / "four_in_line.yaml"
RESTS_S = 10.0


def resting_error_m(correction_1_s: float) -> float:
    """The largest mean distance of a vehicle from its slot about the reference point, over the last RESTS_S."""
    sensors = ("stand_in.sensors=ardupilot_sitl", f"fleet.law.velocity_correction_1_s={correction_1_s}")
    scenario = load_scenario(FOUR_IN_LINE, sensors)
    flown = fly_without_landing(scenario, FlightProgress("test", True, 0.0))
    assert flown.failure is None
    assert flown.watch.formation is not None
    end_s = flown.watch.formation.end_s
    times_s = np.arange(end_s - RESTS_S, end_s, 0.1)
    point = np.array(scenario.reference.point_enu_m)  # type: ignore[union-attr]
    errors_m = [
        np.linalg.norm(flown.tracks()[member.id].at(times_s) - point - np.array(member.slot_enu_m), axis=1).mean()
        for member in scenario.fleet.vehicles
    ]
    return float(max(errors_m))


def test_vehicles_rest_within_a_centimetre_of_their_slots() -> None:
    assert resting_error_m(2.0) < 0.01


def test_without_the_correction_they_rest_centimetres_away() -> None:
    assert resting_error_m(0.0) > 0.03


@pytest.mark.parametrize("bandwidth_1_s", [1.0, 3.0])
@pytest.mark.long
def test_the_bandwidth_may_be_chosen(bandwidth_1_s: float) -> None:
    assert resting_error_m(bandwidth_1_s) < 0.02
