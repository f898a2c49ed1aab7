"""A fleet of two autopilot types and two airframes, with worse sensors on one vehicle, flies as one."""

from pathlib import Path

import pytest

from common import ROOT
from companion.analysis.prediction import SETTLED_WITHIN_M
from companion.types.autopilot import AutopilotKind
from sitl.autopilots.types import hover_thrust_norm
from sitl.flight.flights import FlightEnd, result_of
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.progress import FlightProgress
from sitl.report.summary import in_words

MIXED = ROOT / "config" / "scenarios" / "mixed_platoon.yaml"
PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return load_scenario(MIXED)


@pytest.fixture(scope="module")
def flown(scenario: Scenario) -> Flown:
    return fly_in_virtual_time(scenario, FlightProgress("mixed", True, 0.0))


def test_it_settles_and_keeps_apart(scenario: Scenario, flown: Flown) -> None:
    end = FlightEnd(failure=flown.failure, flight_s=flown.flight_s)
    summary = result_of(scenario, "mixed", flown.watch, flown.tracks(), end).summary
    assert summary.failure is None
    assert summary.smallest_distance_m is not None and summary.smallest_distance_m > 1.0
    assert summary.settle_s is not None and summary.settle_s < 10.0
    assert summary.final_error_m is not None and summary.final_error_m < SETTLED_WITHIN_M
    assert [(v.autopilot, v.sensors) for v in summary.vehicles] == [
        (PX4, "ideal"),
        (PX4, "ideal"),
        (ARDUPILOT, "ideal"),
        (ARDUPILOT, "as given"),
    ]
    assert summary.sensors == "as given and ideal"
    assert "  autopilots        px4 1, 2   ardupilot 3, 4\n" in in_words(summary)


def test_each_vehicle_is_of_its_own_type(flown: Flown, tmp_path: Path) -> None:
    modes = []
    for stand_in in flown.stand_ins:
        stand_in.write_track(track := tmp_path / "track.csv")
        modes.append({line.rpartition(",")[2] for line in track.read_text().splitlines()[1:]})
    assert [stand_in.autopilot.kind for stand_in in flown.stand_ins] == [PX4, PX4, ARDUPILOT, ARDUPILOT]
    assert ["OFFBOARD" in own for own in modes] == [True, True, False, False]
    assert ["GUIDED" in own for own in modes] == [False, False, True, True]


def test_each_agent_knows_its_own_airframe(scenario: Scenario, flown: Flown) -> None:
    for status in flown.watch.statuses():
        own = scenario.stand_in_of(status.agent.vehicle_id)
        assert status.control.hover_thrust_norm == pytest.approx(hover_thrust_norm(own), abs=0.01)
