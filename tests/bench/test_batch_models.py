"""The benchmark: our models track their targets, and the table compares models with the same integrator."""

import numpy as np
import pytest

from lockstep_fleet import platoon
from tests.bench import batch_models
from tests.bench.batch_models import formations, ours

pytestmark = pytest.mark.long


@pytest.mark.parametrize("runge_kutta", [False, True])
def test_our_vehicles_track_the_commanded_pitch(runge_kutta: bool) -> None:
    step = ours(3, runge_kutta)
    for _ in range(250):
        step()
    cells = dict(zip(step.__code__.co_freevars, (cell.cell_contents for cell in step.__closure__ or ()), strict=True))  # type: ignore[attr-defined]
    pitch_rad = 2.0 * np.arctan2(cells["state"][8], cells["state"][6])
    assert pitch_rad == pytest.approx([np.radians(5.0)] * 3, abs=1e-3)
    assert (cells["state"][3] > 0.5).all()


def test_whole_formations_make_a_step() -> None:
    formations(platoon(), 8)()


def test_ratios_compare_models_with_the_same_integrator() -> None:
    rates = {
        "vehicle model, Euler": 9000.0,
        "vehicle model, RK4": 3000.0,
        "whole formations": 3000.0,
        "RotorPy, Euler, no drag": 300.0,
        "RotorPy, Euler": 200.0,
        "RotorPy, RK4, no drag": 150.0,
        "RotorPy, RK4": 100.0,
    }
    ratios = [line.split()[-1] for line in batch_models.table(1000, rates).split("ratio\n")[1].splitlines()]
    assert ratios == ["30.0", "45.0", "20.0", "30.0", "10.0"]
