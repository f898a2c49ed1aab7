"""One scenario flown by real processes and in virtual time: the same flight, to centimetres."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from companion.stability.arrays import FloatArray
from own_ports import free_fleet_offset
from repository import ROOT
from sitl.report.summary import read_summary
from sitl.report.tracks import read_track

pytestmark = [pytest.mark.fleet, pytest.mark.timeout(300)]

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
FORMATION_S = 12.0
# Real vehicles enter formation up to two ticks apart, depending on the start of their processes: two real flights differ, too.
# And the phases of real ticks drift: states have ages of up to a tick, over which they are extrapolated. In virtual time the
# phases are constant, and a constant delay is not known. Measured: 2.5 to 3.5 cm RMS, 6 cm at most; without extrapolation
# 1.2 cm RMS.
RMS_M, MAX_M = 0.05, 0.1


def fly(how: str, folder: Path, *more: str) -> None:
    arguments = [str(PLATOON), "--out", str(folder), "--quiet", "--set", f"timeline[3].for_s={FORMATION_S}", *more]
    done = subprocess.run(
        [sys.executable, "-m", "sitl", how, *arguments], capture_output=True, text=True, timeout=200, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


def offboard_s(folder: Path, vehicle_id: int) -> float:
    """When the stand-in began to follow its agent, on the track's clock."""
    lines = (folder / f"truth_{vehicle_id}.csv").read_text(encoding="ascii").splitlines()
    return next(float(line.split(",")[0]) for line in lines if line.endswith(",OFFBOARD"))


def positions(folder: Path) -> FloatArray:
    """True positions (vehicle, sample, 3) over the formation."""
    begin_s = max(offboard_s(folder, vehicle_id) for vehicle_id in (1, 2, 3, 4))
    times_s = begin_s + np.arange(0.0, FORMATION_S, 0.02)
    return np.stack([read_track(folder / f"truth_{vehicle_id}.csv").at(times_s) for vehicle_id in (1, 2, 3, 4)])


def test_real_processes_and_virtual_time_agree(tmp_path: Path) -> None:
    fly("fly", tmp_path / "fly", "--port-offset", str(free_fleet_offset()))
    fly("run", tmp_path / "run")
    apart_m = np.linalg.norm(positions(tmp_path / "fly") - positions(tmp_path / "run"), axis=2)
    assert np.sqrt((apart_m**2).mean(axis=1)).max() <= RMS_M
    assert apart_m.max() <= MAX_M
    real, virtual = (read_summary(tmp_path / how / "summary.json") for how in ("fly", "run"))
    assert real.max_distance_m is not None
    assert virtual.max_distance_m == pytest.approx(real.max_distance_m, abs=0.02)
