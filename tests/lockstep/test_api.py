"""Flights from Python: arrays and tables, the same flights as `sitl run`, and the examples of the page and the notebook."""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common import ROOT
from companion.config.file import ConfigError
from companion.types.errors import UnusableError
from sitl.api import FlightData, analyze, fly, fly_seeds, load
from sitl.flight.flights import DivergesError, FlightOptions, run_virtual
from sitl.report.metrics import read_track
from sitl.report.summary import read_summary

SHORT = {"timeline[3].for_s": 4.0}
NOISY = SHORT | {"stand_in.sensors": "default"}
NOTEBOOK = ROOT / "config" / "examples" / "formations.ipynb"


@pytest.fixture(scope="module")
def flight() -> FlightData:
    return fly("platoon", overrides=SHORT)


def test_the_arrays_have_their_shapes_and_agree(flight: FlightData) -> None:
    count = flight.time_s.size
    assert flight.vehicles == (1, 2, 3, 4)
    assert flight.pairs == ((1, 2), (1, 3), (1, 4), (2, 3), (2, 4), (3, 4))
    assert np.diff(flight.time_s) == pytest.approx(0.02)
    assert flight.positions_enu_m.shape == flight.velocities_enu_m_s.shape == (count, 4, 3)
    assert flight.setpoints.shape == (count, 4, 4)
    assert flight.errors_m.shape == (count, 4) and flight.distances_m.shape == (count, 6)
    apart = np.linalg.norm(flight.positions_enu_m[:, 1] - flight.positions_enu_m[:, 3], axis=1)
    assert flight.distances_m[:, flight.pairs.index((2, 4))] == pytest.approx(apart)
    formed = ~np.isnan(flight.errors_m[:, 0])
    assert 3.9 < formed.sum() * 0.02 < 5.5
    moved = np.diff(flight.positions_enu_m[formed], axis=0) / 0.02
    assert np.abs(moved - flight.velocities_enu_m_s[formed][1:]).max() < 0.05
    assert np.isfinite(flight.setpoints[formed]).all() and np.isnan(flight.setpoints[:50]).all()
    assert 0.2 < flight.setpoints[formed, :, 3].mean() < 0.8
    # at the end of the formation each vehicle is about as far from its slot as the summary says
    last = np.sqrt(np.mean(flight.errors_m[formed][-100:] ** 2, axis=0))
    assert last == pytest.approx([vehicle.final_error_m for vehicle in flight.summary.vehicles], rel=0.02)
    assert {event.vehicle for event in flight.events} == {1, 2, 3, 4}
    assert [event.time_s for event in flight.events] == sorted(event.time_s for event in flight.events)


def test_it_is_the_flight_of_the_command_line(flight: FlightData, tmp_path: Path) -> None:
    options = FlightOptions(
        scenario=Path("platoon"), overrides=["timeline[3].for_s=4.0"], out=tmp_path / "run", quiet=True
    )
    assert run_virtual(options) == 0
    track = read_track(tmp_path / "run" / "truth_3.csv")
    assert np.abs(track.position_enu_m - flight.positions_enu_m[:, 2]).max() < 1e-5
    written = read_summary(tmp_path / "run" / "summary.json")
    assert (written.min_distance_m, written.events) == (flight.summary.min_distance_m, flight.summary.events)
    assert written.scenario == flight.summary.scenario == "platoon"


def test_seeds_fly_in_parallel_as_alone() -> None:
    several = fly_seeds("platoon", (3, 1), overrides=NOISY, processes=2, quiet=True)
    alone = fly("platoon", seed=1, overrides=NOISY)
    assert [one.summary.seed for one in several] == [3, 1]
    assert np.array_equal(several[1].positions_enu_m, alone.positions_enu_m)
    assert not np.array_equal(several[0].positions_enu_m, alone.positions_enu_m)


def test_a_scenario_is_changed_by_values_of_python_and_numpy(tmp_path: Path) -> None:
    start = np.array([-1.5, 0.1, 0.0])
    first = load("platoon", {"starts_enu_m.2": start, "stand_in.seed": np.int64(4), "links.peer_loss": 1e-05})
    again = load(first, {"stand_in.sensors": "default"}, law="average_22")
    assert again.starts_enu_m[2] == (-1.5, 0.1, 0.0)
    assert (again.stand_in.seed, again.links.peer_loss, again.stand_in.sensors) == (4, 1e-05, "default")
    assert again.fleet.law.name == "average_22" and first.fleet.law.name == "weighted"
    assert load(first) is first and load("platoon", law="weighted") == load("platoon")
    assert load("platoon", {"fleet.law.name": "cooperative"}, law="average_22").fleet.law.name == "cooperative"
    copied = tmp_path / "mine.yaml"
    copied.write_text((ROOT / "config/scenarios/platoon.yaml").read_text(encoding="utf-8"), encoding="utf-8")
    assert load(copied) == load("platoon")


def test_what_cannot_be_flown_is_one_line() -> None:
    with pytest.raises(ConfigError, match=r"platoon: fleet\.law\.name: 'none' is no law; expected one of cooperative"):
        fly("platoon", law="none")
    with pytest.raises(ConfigError, match=r"platoon: stand_in\.seed: -1"):
        fly("platoon", seed=-1)
    with pytest.raises(ConfigError, match=r"^law: mine/missing\.py: cannot be read"):
        load("platoon", law="mine/missing.py")
    with pytest.raises(ConfigError, match="did you mean platoon"):
        load("platon")
    unreached = {"fleet.neighbours": {"kind": "edges", "edges": [[1, 2]]}}
    with pytest.raises(DivergesError, match="no path leads from a leader"):
        fly("platoon", overrides=unreached)
    with pytest.raises(DivergesError, match="no path leads from a leader"):
        fly_seeds("platoon", [1], overrides=unreached)


def test_a_flight_that_fails_is_a_result() -> None:
    failed = fly("platoon", overrides={"timeline[2]": {"command": "land", "timeout_s": 1.0}})
    assert failed.summary.failure is not None
    assert np.isnan(failed.errors_m).all() and failed.positions_enu_m.shape[1:] == (4, 3)


def test_the_analysis_is_that_of_the_command_line(capsys: pytest.CaptureFixture[str]) -> None:
    from msgspec import json as encoded

    from companion.cli.main import main

    assert main(["analyze", str(ROOT / "config/scenarios/platoon.yaml"), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    found = json.loads(encoded.encode(analyze("platoon")))
    for key in found.keys() - {"file", "not_read"}:
        assert found[key] == printed[key], key
    assert analyze("platoon", law="average_22").law == "average_22"


def test_tables_have_a_row_for_each_time_and_vehicle(flight: FlightData) -> None:
    pytest.importorskip("pandas")
    table: Any = flight.to_pandas()
    assert len(table) == flight.time_s.size * 4
    of_2 = table[table["vehicle"] == 2]
    assert np.array_equal(of_2["time_s"], flight.time_s)
    assert np.array_equal(of_2[["x_m", "y_m", "z_m"]], flight.positions_enu_m[:, 1])
    assert np.array_equal(of_2[["vx_m_s", "vy_m_s", "vz_m_s"]], flight.velocities_enu_m_s[:, 1])
    commanded = of_2[["roll_rad", "pitch_rad", "yaw_rad", "thrust_norm"]]
    assert np.array_equal(commanded, flight.setpoints[:, 1], equal_nan=True)
    assert np.array_equal(of_2["error_m"], flight.errors_m[:, 1], equal_nan=True)
    apart: Any = flight.distances_to_pandas()
    assert np.array_equal(apart["2-4"], flight.distances_m[:, 4]) and apart.index.name == "time_s"


def test_without_pandas_a_table_is_one_line(flight: FlightData, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    for table in (flight.to_pandas, flight.distances_to_pandas):
        with pytest.raises(UnusableError, match="pandas is not installed; pip install pandas"):
            table()


@pytest.mark.long
def test_the_notebook_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(tmp_path)
    notebook = json.loads(NOTEBOOK.read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(not cell["outputs"] and cell["execution_count"] is None for cell in cells)
    names: dict[str, Any] = {"__name__": "notebook"}
    for cell in cells:
        exec(compile("".join(cell["source"]), cell["id"], "exec"), names)
    assert "4, 3)" in capsys.readouterr().out
    assert names["curved"].summary.failure is None and names["curved"].summary.vehicles[0].tracking_error_m < 0.1


def test_the_examples_of_the_page_run() -> None:
    page = (ROOT / "docs" / "python-api.md").read_text(encoding="utf-8")
    names: dict[str, Any] = {"__name__": "__main__"}
    for example in re.findall(r"^```python\n(.*?)^```$", page, re.DOTALL | re.MULTILINE):
        exec(compile(example, "python-api.md", "exec"), names)
    assert names["flight"].summary.law == "average_22" and len(names["flights"]) == 2
