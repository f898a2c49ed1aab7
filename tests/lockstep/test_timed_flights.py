"""References through samples and from a Python file, flown; and what goes with the files of a flight."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace

from common import ROOT
from companion.config import code_file
from companion.config.file import ConfigError
from companion.config.reference import PointReference
from companion.config.vehicle import load_agent
from companion.recording.codec import recorded_config
from companion.recording.reader import recordings
from companion.types.notices import Code
from sitl.flight.files import write_files
from sitl.flight.flights import FlightOptions, run_virtual
from sitl.flight.scenario import Scenario, load_scenario, reference_of
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress

CSV = "t,x,y,z\n0,1,0,2\n8,6,3,2.5\n15,8,-2,3\n22,3,-4,2\n30,1,0,2\n"
CODE = """
from math import cos, sin
def reference(time_s):
    w = 0.3
    c, s = cos(w * time_s), sin(w * time_s)
    return (4 * s, 4 * c - 4, 2), (4 * w * c, -4 * w * s, 0), (-4 * w * w * s, -4 * w * w * c, 0)
"""
SAMPLES = "{kind: samples, file: path.csv}"
FUNCTION = "{kind: file, file: path.py, lasts_s: 28}"
POINT = PointReference((1.0, 0.0, 2.0))
FLOWN = (
    "starts_enu_m={1: [0, 0, 0], 2: [-2, 0, 0], 3: [-4, 0, 0], 4: [-6, 0, 0]}",
    "fleet.law.name=cooperative",
    "stand_in.sensors=ideal",
    "timeline[3].for_s=40",
)


def scenario_with(folder: Path, reference: str) -> Scenario:
    """The platoon with this reference, in a folder that only its owner can write."""
    folder.chmod(0o755)
    shutil.copy(ROOT / "config" / "scenarios" / "platoon.yaml", folder)
    for name, text in {"path.csv": CSV, "path.py": CODE}.items():
        (folder / name).write_text(text, encoding="utf-8")
        (folder / name).chmod(0o644)
    return load_scenario(folder / "platoon.yaml", [f"reference={reference}", *FLOWN])


@pytest.mark.parametrize("reference", [SAMPLES, FUNCTION])
def test_the_leader_follows_it(reference: str, tmp_path: Path) -> None:
    scenario = scenario_with(tmp_path, reference)
    flown = fly_in_virtual_time(scenario, FlightProgress("", quiet=True, began_s=0.0))
    assert flown.failure is None
    assert flown.watch.formation is not None
    formation, planned = flown.watch.formation, reference_of(scenario)
    times_s = formation.times_s()[500:]
    wanted = np.array([planned(time_s - formation.reference_start_s).position_enu_m for time_s in times_s.tolist()])
    assert np.ptp(wanted, axis=0)[:2].min() > 4.0  # it moves
    assert np.linalg.norm(flown.tracks()[1].at(times_s) - wanted, axis=1).max() < 0.1


@pytest.mark.parametrize("reference", [SAMPLES, FUNCTION])
def test_the_files_of_a_flight_hold_it(reference: str, tmp_path: Path) -> None:
    scenario, folder = scenario_with(tmp_path, reference), tmp_path / "run"
    folder.mkdir(mode=0o755)
    write_files(scenario, folder, port_offset=0)
    for name in ("path.csv", "path.py"):
        (tmp_path / name).unlink()
    again, vehicle = load_scenario(folder / "scenario.yaml"), load_agent(folder / "vehicle_1.yaml").vehicle
    assert vehicle.reference is not None
    for time_s in (0.0, 7.3, 20.0, 99.0):
        wanted = scenario.reference.curve()(time_s)
        assert again.reference.curve()(time_s) == vehicle.reference.curve()(time_s) == wanted


def test_a_step_of_the_timeline_brings_samples_and_no_code(tmp_path: Path) -> None:
    step = f"{{command: reference, reference: {SAMPLES}, for_s: 30}}"
    scenario_with(tmp_path, SAMPLES)
    loaded = load_scenario(tmp_path / "platoon.yaml", [f"timeline[4]={step}", *FLOWN])
    assert loaded.timeline[4].reference is not None and loaded.timeline[4].reference.curve_s() == 30.0
    flown = fly_in_virtual_time(replace(loaded, reference=POINT), FlightProgress("", quiet=True, began_s=0.0))
    assert flown.failure is None
    changes = [event.event for event in flown.watch.events if event.code is Code.REFERENCE_CHANGED]
    assert len(changes) == 1 and "hand-over of" in changes[0]
    led = flown.watch.led_enu_m
    assert max(x for _, (x, _, _) in led) > 7.0 and max(y for _, (_, y, _) in led) > 2.5
    with pytest.raises(ConfigError, match=r"timeline\[4\]\.reference\.kind: file: a command brings no code"):
        load_scenario(tmp_path / "platoon.yaml", [f"timeline[4]={step.replace(SAMPLES, FUNCTION)}", *FLOWN])


def test_a_recording_runs_no_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scenario_with(tmp_path, FUNCTION)
    out = tmp_path / "out"
    overrides = (f"reference={FUNCTION}", *FLOWN, "timeline[3].for_s=0.5")
    options = FlightOptions(scenario=tmp_path / "platoon.yaml", overrides=overrides, out=out, quiet=True, record=True)
    assert run_virtual(options) == 0
    header = recordings(out, print)[0].header
    recorded_config(out, header)  # in the process that has loaded it
    elsewhere = header.vehicle_file.replace("path.py", "other.py")
    monkeypatch.setattr(code_file, "LOADED", {})  # another process
    with pytest.raises(ConfigError, match=r"is code with the SHA-256 [0-9a-f]{64} that has not been read"):
        recorded_config(out, replace(header, vehicle_file=elsewhere))
