"""`sitl sweep` from the command line: folder, output, exit codes, and agreement with `sitl run`."""

import csv
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import msgspec
import pytest

from common import ROOT
from sitl.flight.scenario import load_scenario, reference_of
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.metrics import formation_figures, neighbouring_pairs, pair_name, stand_at
from sitl.report.progress import FlightProgress, ShareProgress
from sitl.sweep import flights
from sitl.sweep.options import SweepOptions
from sitl.sweep.run import run as run_sweep

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
PNG = b"\x89PNG\r\n\x1a\n"
PEAK_TOLERANCE_M = 0.005  # lockstep enters the formation slightly off its starts and not quite at rest; measured: 0.001
SETTLE_TOLERANCE_S = 0.1  # and its time starts when the last vehicle enters; measured: 0.02


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "sitl", "sweep", *map(str, arguments)]


def sweep(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=120, check=False)


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "sweep.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.long
def test_figures_agree_with_sitl_run(tmp_path: Path) -> None:
    laws = ("weighted", "cooperative")
    options = SweepOptions(PLATOON, (f"fleet.law.name={','.join(laws)}",), 2, 30.0, out=tmp_path, quiet=True)
    assert run_sweep(options) == 0
    rows = {row["fleet.law.name"]: row for row in rows_of(tmp_path) if row["seed"] == "2"}
    for law in laws:
        scenario = load_scenario(PLATOON, [f"fleet.law.name={law}", "timeline[3].for_s=30", "stand_in.seed=2"])
        flown = fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0))
        assert flown.watch.formation is not None
        slots = {member.id: member.slot_enu_m for member in scenario.fleet.vehicles}
        expected = formation_figures(flown.tracks(), stand_at(slots), reference_of(scenario), flown.watch.formation)
        near = [pair_name(pair) for pair in neighbouring_pairs(slots)]
        row = rows[law]
        assert float(row["largest_neighbouring_distance_m"]) == pytest.approx(
            max(expected.max_distance_m[pair] for pair in near), abs=PEAK_TOLERANCE_M
        )
        smallest_m = min(expected.min_distance_m[pair] for pair in near)
        assert float(row["smallest_neighbouring_distance_m"]) == pytest.approx(smallest_m, abs=PEAK_TOLERANCE_M)
        assert float(row["smallest_distance_m"]) == pytest.approx(smallest_m, abs=PEAK_TOLERANCE_M)
        assert float(row["final_error_m"]) == pytest.approx(expected.final_error_m, abs=PEAK_TOLERANCE_M)
        assert float(row["settle_s"]) == pytest.approx(expected.settle_s, abs=SETTLE_TOLERANCE_S)


def test_a_sweep_is_the_same_for_any_number_of_workers(tmp_path: Path) -> None:
    """Three kinds of flights for several chunks; noise and loss for random numbers."""
    varied = (
        "stand_in.sensors=ideal,default",
        "links.peer_loss=0,0.2",
        "stand_in.airframe.attitude=rigid_body,instant",
    )
    for folder, processes in ((tmp_path / "one", 1), (tmp_path / "two", 2)):
        assert run_sweep(SweepOptions(PLATOON, varied, 3, 3.0, out=folder, quiet=True, processes=processes)) == 0
    for name in ("sweep.csv", "sweep.json"):
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes()
    rows = rows_of(tmp_path / "one")
    assert len(rows) == 24
    noisy = [row for row in rows if row["stand_in.sensors"] == "default"]
    assert len({(row["final_error_m"], row["smallest_distance_m"]) for row in noisy}) == 12  # each with its own noise


def test_the_folder_and_the_output(tmp_path: Path) -> None:
    varied = ("--vary", "fleet.law.name=weighted,cooperative", "--vary", "fleet.law.parameters.exponent=0,2")
    done = sweep(PLATOON, *varied, "--seeds", 3, "--seconds", 4, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    assert all("of 12 flights" in line for line in done.stderr.splitlines()), "on a slow machine it shows its progress"
    printed = done.stdout.splitlines()
    assert printed[0] == "platoon: 12 flights of 4 vehicles, 4 s each"
    assert printed[-1] == f"results in {tmp_path}"
    assert printed[-2].endswith("times real time")
    assert (tmp_path / "sweep.png").read_bytes().startswith(PNG)
    assert len(rows_of(tmp_path)) == 12
    content: dict[str, Any] = msgspec.json.decode((tmp_path / "sweep.json").read_bytes())
    assert (content["schema"], content["scenario"], content["complete"]) == (1, "platoon", True)
    assert content["vary"] == {"fleet.law.name": ["weighted", "cooperative"], "fleet.law.parameters.exponent": [0, 2]}
    assert [one["flights"] for one in content["combinations"]] == [3] * 4


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("nowhere.yaml",), "nowhere.yaml: cannot be read: No such file"),
        ((PLATOON, "--set", "links.peer_loss=1.5"), "--set: links.peer_loss: 1.5"),
        ((PLATOON, "--vary", "links.peer_loss=0,1.5"), "--vary links.peer_loss=1.5: links.peer_loss: 1.5"),
        ((PLATOON, "--out", "/dev/null/x"), "choose another folder with --out"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[object, ...], text: str) -> None:
    done = sweep(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("argument", [("--seeds", "0"), ("--seeds", "many"), ("--seconds", "1"), ("--seconds", "nan")])
def test_a_bad_number_is_refused(argument: tuple[str, str]) -> None:
    done = sweep(PLATOON, *argument)
    assert done.returncode == 2
    assert f"argument {argument[0]}: '{argument[1]}', expected" in done.stderr


def test_ctrl_c_ends_all_processes_with_one_line(tmp_path: Path) -> None:
    """The workers get the signal too, as in a terminal."""
    arguments = (PLATOON, "--seeds", 3000, "--seconds", 3600, "--out", tmp_path)
    with subprocess.Popen(
        command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        assert "0 of 3000 flights" in process.stderr.readline()
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors == f"stopped before any flight was complete; nothing in {tmp_path}\n"
    assert printed == ""


def test_ctrl_c_keeps_complete_flights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(_progress: ShareProgress, _share: float, more: str = "") -> None:
        if more and not more.startswith("0 of"):
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ShareProgress, "show", interrupt)
    monkeypatch.setattr(flights, "chunk_size", lambda *_: 5)
    varied = ("fleet.law.name=weighted,cooperative",)
    assert run_sweep(SweepOptions(PLATOON, varied, 1000, 3.0, out=tmp_path, processes=1)) == 130
    rows = rows_of(tmp_path)
    assert 5 <= len(rows) < 500
    assert [int(row["seed"]) for row in rows] == list(range(1, len(rows) + 1))
    content: dict[str, Any] = msgspec.json.decode((tmp_path / "sweep.json").read_bytes())
    assert not content["complete"]
    assert [one["flights"] for one in content["combinations"]] == [len(rows)]
    assert (tmp_path / "sweep.png").read_bytes().startswith(PNG)
    assert "stopped before the end" in capsys.readouterr().out
