"""Real processes whose local frames have origins 50 m apart; an estimator resets in flight, twice."""

from pathlib import Path

import pytest

from common import ROOT
from companion.types.notices import Code
from process_fleet import fly
from sitl.report.summary import read_summary

pytestmark = [pytest.mark.fleet, pytest.mark.long, pytest.mark.timeout(300)]

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
OVERRIDES = (
    "fleet.law={name: cooperative}",
    "timeline[3].for_s=30",
    "origins_enu_m={1: [50, 0, 2], 2: [0, 50, -2], 3: [-50, 0, 1], 4: [0, -50, 0]}",
    "stand_in.estimator_resets=["
    "{vehicle: 3, at_s: 28, shift_enu_m: [0, 1, 0]}, {vehicle: 3, at_s: 31, shift_enu_m: [0, -1, 0]}]",
)


def test_vehicles_with_different_local_frames_reach_one_formation(tmp_path: Path) -> None:
    sets = [argument for override in OVERRIDES for argument in ("--set", override)]
    fly(PLATOON, tmp_path, "--quiet", *sets)
    summary = read_summary(tmp_path / "summary.json")
    assert summary.final_error_m is not None
    assert summary.final_error_m < 0.03
    jumps = [event.vehicle for event in summary.events if event.code is Code.POSITION_RESET and "1.0 m" in event.event]
    assert set(jumps) == {3}
    assert all(vehicle.rejected == {} for vehicle in summary.vehicles)
