"""Eight agents through the shapes of config/scenarios/formations.yaml, on a moving reference: `make test-long`."""

from functools import cache
from itertools import combinations

import numpy as np
import pytest

from common import ROOT
from sitl.flight.scenario import load_scenario, reference_of
from sitl.flight.virtual_flight import Flown, fly_without_landing
from sitl.report.metrics import SAMPLE_S, Track, errors_m, pairs_of, reference_positions_m
from sitl.report.progress import FlightProgress

SCENARIO = ROOT / "config" / "scenarios" / "formations.yaml"
IDEAL = "stand_in.sensors=ideal"
pytestmark = pytest.mark.long


@cache
def flown(*overrides: str) -> Flown:
    flight = fly_without_landing(load_scenario(SCENARIO, overrides), FlightProgress("test", True, 0.0))
    assert flight.failure is None
    return flight


def steady_times_s(flight: Flown) -> np.ndarray:
    """Times of the formation without its first seconds."""
    formation = flight.watch.formation
    assert formation is not None
    return np.arange(formation.start_s + 6.0, formation.end_s, SAMPLE_S)


def smallest_m(tracks: dict[int, Track], times_s: np.ndarray) -> float:
    at = {i: track.at(times_s) for i, track in tracks.items()}
    return min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))


def test_all_shapes_are_flown_in_sequence() -> None:
    flight = flown(IDEAL)
    assert flight.watch.formation is not None
    slots = flight.watch.slots()
    changes = {e.event for e in flight.watch.events if e.vehicle == 5 and e.event.startswith("formation ")}
    assert {f"formation {n} -> {n + 1}" for n in range(4)} <= changes
    end = {i: slot.at(np.array([flight.watch.formation.end_s]))[0] for i, slot in slots.items()}
    assert sorted(round(float(y), 6) for _, y, _ in end.values()) == [-7.0, -5.0, -3.0, -1.0, 1.0, 3.0, 5.0, 7.0]


def test_vehicles_keep_the_distances_of_their_slots() -> None:
    """Slots with a spacing of 2 m keep 1.41 m or more during transitions."""
    flight = flown(IDEAL)
    times_s = steady_times_s(flight)
    desired_m = smallest_m(flight.watch.slots(), times_s)
    assert 2.0 / np.sqrt(2.0) - 1e-6 <= desired_m <= 2.0
    assert smallest_m(flight.tracks(), times_s) > desired_m - 0.1


def test_vehicles_keep_the_separation_with_noise() -> None:
    flight = flown()
    assert smallest_m(flight.tracks(), steady_times_s(flight)) > 1.0


@pytest.mark.parametrize(("overrides", "most_m"), [((IDEAL,), 0.3), ((), 0.5)])
def test_vehicles_stay_near_their_moving_slots(overrides: tuple[str, ...], most_m: float) -> None:
    flight = flown(*overrides)
    assert flight.watch.formation is not None
    times_s, slots = steady_times_s(flight), flight.watch.slots()
    scenario = load_scenario(SCENARIO, overrides)
    r_m = reference_positions_m(reference_of(scenario), flight.watch.formation.reference_start_s, times_s)
    errors = {i: errors_m(track, slots[i], r_m, times_s).max() for i, track in flight.tracks().items()}
    assert max(errors.values()) < most_m, errors
    assert len(pairs_of(errors)) == 28
