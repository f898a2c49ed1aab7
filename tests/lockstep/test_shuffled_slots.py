"""Vehicles that stand otherwise than their slots: they do not fly through each other, and a formation command puts it right."""

from pathlib import Path

from sitl.progress import Progress
from sitl.scenario import load_scenario
from sitl.virtual_flight import Flown, fly_in_virtual_time

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
SHUFFLED = ("starts_enu_m.2=[-3.0,0.0,0.0]", "starts_enu_m.3=[-1.5,0.0,0.0]", "fleet.law.name=cooperative")
COLUMN = "{command: formation, formation: {shape: column, spacing_m: 1.5}}"
UP, DOWN = "{command: takeoff, for_s: 3}, {command: form, for_s: 15, timeout_s: 3}", "{command: land}"


def flown(timeline: str) -> Flown:
    scenario = load_scenario(PLATOON, [*SHUFFLED, f"timeline=[{timeline}]"])
    return fly_in_virtual_time(scenario, Progress("test", True, 0.0))


def test_who_would_pass_through_another_is_refused_to_form() -> None:
    flight = flown(f"{{command: prepare}}, {{command: arm}}, {UP}, {DOWN}")
    assert flight.failure is not None
    assert flight.failure.startswith("form not done within 3 s: ")
    assert not [formation for formation in flight.watch.formations if formation.end_s > formation.start_s]
    tracks = flight.tracks()
    moved_m = [abs(tracks[i].position_enu_m[:, 0] - tracks[i].position_enu_m[0, 0]).max() for i in (2, 3)]
    assert max(moved_m) < 0.5


def test_a_formation_given_on_the_ground_fits_where_they_stand() -> None:
    flight = flown(f"{{command: prepare}}, {COLUMN}, {{command: arm}}, {UP}, {DOWN}")
    assert flight.failure is None
    slots = flight.watch.slots()
    end_s = flight.watch.formations[-1].end_s
    behind_m = {i: float(slots[i].at([end_s])[0][0]) for i in (1, 2, 3, 4)}  # type: ignore[arg-type]
    assert sorted(behind_m, key=lambda i: -behind_m[i]) == [1, 3, 2, 4]
