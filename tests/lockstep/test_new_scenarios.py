"""Scenarios as `sitl new` writes them: analyzed, flown and landed, with separation."""

import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from companion.tools.analysis import analyse
from companion.tools.subject import load_subject
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.metrics import SAMPLE_S
from sitl.report.progress import FlightProgress

V_ON_CIRCLE = ("--vehicles", "5", "--shape", "v", "--spacing", "3", "--reference", "circle")
COLUMN_ON_EIGHT = (
    "--vehicles", "4", "--shape", "column", "--topology", "double", "--reference", "figure_8", "--heading", "course"
)  # fmt: skip
LAYERS = ("--vehicles", "6", "--shape", "layers", "--spacing", "2", "--topology", "range", "--reference", "waypoints")


@pytest.mark.parametrize(
    "choices",
    [
        pytest.param(V_ON_CIRCLE, id="v"),
        pytest.param(COLUMN_ON_EIGHT, id="column", marks=pytest.mark.long),
        pytest.param(LAYERS, id="layers", marks=pytest.mark.long),
    ],
)
def test_a_new_scenario_flies_as_it_is(choices: tuple[str, ...], tmp_path: Path) -> None:
    subprocess.run([sys.executable, "-m", "sitl", "new", "new", *choices], cwd=tmp_path, timeout=60, check=True)
    path = tmp_path / "new.yaml"
    assert analyse(load_subject(path)).converges
    scenario = load_scenario(path)
    flight = fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))
    assert flight.failure is None and flight.watch.formation is not None
    times_s = np.arange(flight.watch.formation.start_s, flight.watch.formation.end_s, SAMPLE_S)
    at = {i: track.at(times_s) for i, track in flight.tracks().items()}
    nearest_m = min(float(np.linalg.norm(at[i] - at[j], axis=1).min()) for i, j in combinations(at, 2))
    assert nearest_m > scenario.fleet.separation_m
