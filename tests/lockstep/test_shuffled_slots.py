"""Vehicles on the ground in another order than their slots: they pass each other, or a formation command fits them."""

import numpy as np

from common import ROOT
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.progress import FlightProgress

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
SHUFFLED = ("starts_enu_m.2=[-3.0,0.0,0.0]", "starts_enu_m.3=[-1.5,0.0,0.0]", "fleet.law.name=cooperative")
COLUMN = "{command: formation, formation: {shape: column, spacing_m: 1.5}}"
UP, DOWN = "{command: takeoff, for_s: 3}, {command: form, for_s: 15, timeout_s: 3}", "{command: land}"


def flown(timeline: str) -> Flown:
    scenario = load_scenario(PLATOON, [*SHUFFLED, f"timeline=[{timeline}]"])
    return fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))


def test_vehicles_that_form_through_each_other_pass_at_a_distance() -> None:
    flight = flown(f"{{command: prepare}}, {{command: arm}}, {UP}, {DOWN}")
    assert flight.failure is None
    tracks = flight.tracks()
    times_s = tracks[2].time_s[tracks[2].position_enu_m[:, 2] > 0.5]
    apart_m = np.linalg.norm(tracks[2].at(times_s) - tracks[3].at(times_s), axis=1)
    assert apart_m.min() > 1.0


def test_a_formation_commanded_on_the_ground_fits_the_positions() -> None:
    flight = flown(f"{{command: prepare}}, {COLUMN}, {{command: arm}}, {UP}, {DOWN}")
    assert flight.failure is None
    slots = flight.watch.slots()
    end_s = flight.watch.formations[-1].end_s
    behind_m = {i: float(slots[i].at([end_s])[0][0]) for i in (1, 2, 3, 4)}  # type: ignore[arg-type]
    assert sorted(behind_m, key=lambda i: -behind_m[i]) == [1, 3, 2, 4]
