"""The figures of a batch equal those of sitl.report.metrics, formation by formation."""

import numpy as np
import pytest

from lockstep_fleet import platoon
from sitl.batch.flight import BatchFlight, fly_batch
from sitl.batch.metrics import BatchFigures, batch_figures, settle_times_s
from sitl.flight.scenario import Scenario, reference_of
from sitl.report.metrics import (
    Formation,
    FormationFigures,
    Track,
    formation_figures,
    neighbouring_pairs,
    pair_name,
    settle_time_s,
    stand_at,
)

SQUARE = (
    "fleet.vehicles=[{id: 1, role: leader, slot_enu_m: [0, 0, 0]}, {id: 2, role: follower, slot_enu_m: [-1, 0, 0]},"
)
SQUARE += " {id: 3, role: follower, slot_enu_m: [-1, 1, 0]}, {id: 4, role: follower, slot_enu_m: [0, 1, 0]}]"
SCENARIOS = [
    platoon(),
    platoon("fleet.law={name: cooperative}"),
    platoon(SQUARE, "reference.point_enu_m=[1.0, 1.0, 1.0]"),
    platoon("stand_in.sensors=default"),
]


@pytest.fixture(scope="module")
def flight() -> BatchFlight:
    return fly_batch(SCENARIOS, 12.0)


def one_by_one(flight: BatchFlight, b: int, scenario: Scenario) -> FormationFigures:
    positions = flight.positions_enu_m[:, b].astype(np.float64)
    tracks = {i + 1: Track(flight.times_s, positions[:, i]) for i in range(4)}
    end_s = float(flight.times_s[-1])
    slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
    return formation_figures(tracks, stand_at(slots), reference_of(scenario), Formation(0.0, end_s, 0.0))


@pytest.mark.parametrize("b", range(len(SCENARIOS)))
def test_figures_equal_those_of_the_single_flight(flight: BatchFlight, b: int) -> None:
    figures: BatchFigures = batch_figures(flight)
    single = one_by_one(flight, b, SCENARIOS[b])
    near = {pair_name(p) for p in neighbouring_pairs({m.id: m.slot_enu_m for m in SCENARIOS[b].fleet.vehicles})}
    settled = float("nan") if single.settle_s is None else single.settle_s
    assert figures.settle_s[b] == pytest.approx(settled, nan_ok=True)
    assert figures.final_error_m[b] == pytest.approx(single.final_error_m, abs=1e-5)
    assert figures.final_error_of_vehicle_m[b] == pytest.approx(
        [single.final_error_of_vehicle_m[i] for i in (1, 2, 3, 4)], abs=1e-5
    )
    largest, smallest = single.max_distance_m, single.min_distance_m
    assert figures.largest_distance_m[b] == pytest.approx(max(largest.values()), abs=1e-5)
    assert figures.smallest_distance_m[b] == pytest.approx(min(smallest.values()), abs=1e-5)
    assert figures.largest_neighbouring_distance_m[b] == pytest.approx(max(largest[p] for p in near), abs=1e-5)
    assert figures.smallest_neighbouring_distance_m[b] == pytest.approx(min(smallest[p] for p in near), abs=1e-5)


def test_the_example_has_settled_and_unsettled_flights(flight: BatchFlight) -> None:
    settled = np.isfinite(batch_figures(flight).settle_s)
    assert settled.any()
    assert not settled.all()


@pytest.mark.parametrize(
    ("last_outside_s", "settled_s"),
    [(None, 0.0), (0.0, 0.02), (3.0, 3.02), (7.98, 8.0), (8.0, None), (8.02, None), (10.0, None)],
)
def test_settle_time_at_the_bounds(last_outside_s: float | None, settled_s: float | None) -> None:
    times_s = np.arange(501) * 0.02
    error_m = np.zeros(501)
    if last_outside_s is not None:
        error_m[: round(last_outside_s / 0.02) + 1] = 0.2
    expected = float("nan") if settled_s is None else settled_s
    single = settle_time_s(times_s, error_m)
    assert (float("nan") if single is None else single) == pytest.approx(expected, nan_ok=True)
    assert settle_times_s(times_s, error_m[:, None])[0] == pytest.approx(expected, nan_ok=True)
