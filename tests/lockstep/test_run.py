"""`sitl run` from the command line: folder, output and exit codes."""

import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import msgspec
import pytest

from common import ROOT
from companion.types.autopilot import AutopilotKind
from sitl.flight.scenario import load_scenario
from sitl.report.folder import remove_old_run
from sitl.report.metrics import read_track
from sitl.report.summary import read_summary

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
SHORT = ("--set", "timeline[3].for_s=3")
NOISY = ("--set", "stand_in.sensors=default")
PNG = b"\x89PNG\r\n\x1a\n"


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "sitl", "run", *map(str, arguments)]


def run(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=120, check=False)


def content(folder: Path) -> dict[str, Any]:
    """Content of summary.json without the figures that depend on the machine."""
    summary: dict[str, Any] = msgspec.json.decode((folder / "summary.json").read_bytes())
    assert summary.pop("real_time_factor") > 0.0
    return summary


def test_the_folder_has_the_files_of_a_real_flight(tmp_path: Path) -> None:
    done = run(PLATOON, "--out", tmp_path, *SHORT, "--law", "average_22")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert done.stdout.splitlines()[-1] == f"results in {tmp_path}"
    for name in ("figure_5.png", "figure_6.png"):
        assert (tmp_path / name).read_bytes().startswith(PNG)
    assert load_scenario(tmp_path / "scenario.yaml").fleet.law.name == "average_22"
    summary = read_summary(tmp_path / "summary.json")
    assert summary.law == "average_22"
    assert summary.duration_s == pytest.approx(3.0, abs=0.1)
    for vehicle in summary.vehicles:
        assert vehicle.tick is vehicle.telemetry_to_command_us is vehicle.cpu_percent is vehicle.rss_mb is None
        assert vehicle.rejected == {}
        track = read_track(tmp_path / f"truth_{vehicle.id}.csv")
        assert track.time_s[0] == pytest.approx(0.02)
        assert track.time_s[-1] == pytest.approx(summary.flight_s, abs=0.1)
        assert len(track.time_s) == pytest.approx(50 * summary.flight_s, abs=5)


def test_two_runs_write_the_same_results(tmp_path: Path) -> None:
    """In two processes, so that the order of sets and addresses would show."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        assert run(PLATOON, "--out", folder, "--quiet", *SHORT, *NOISY).returncode == 0
    for vehicle_id in (1, 2, 3, 4):
        name = f"truth_{vehicle_id}.csv"
        assert (first / name).read_bytes() == (second / name).read_bytes()
    assert content(first) == content(second)


def test_two_laws_are_compared(tmp_path: Path) -> None:
    done = run(PLATOON, "--out", tmp_path, "--quiet", "--compare", "average_26", *SHORT)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "comparison.png").read_bytes().startswith(PNG)
    comparison: Any = msgspec.json.decode((tmp_path / "comparison.json").read_bytes())
    assert comparison["laws"] == ["weighted", "average_26"]


@dataclass(frozen=True)
class QuietRun:
    """A run into a folder with the files of an older run."""

    folder: Path
    done: subprocess.CompletedProcess[str]


@pytest.fixture(scope="module")
def quiet_run(tmp_path_factory: pytest.TempPathFactory) -> QuietRun:
    """The older run had five vehicles and compared two laws; notes.txt belongs to the user."""
    out = tmp_path_factory.mktemp("older")
    for folder in (out, out / "average_26"):
        folder.mkdir(exist_ok=True)
        for name in ("scenario.yaml", "truth_5.csv", "vehicle_5.yaml", "agent_5.log", "comparison.json", "notes.txt"):
            (folder / name).touch()
    (out / "average_26" / "notes.txt").unlink()
    return QuietRun(out, run(PLATOON, "--out", out, "--quiet", *SHORT))


def test_files_of_an_older_run_are_removed_and_others_are_kept(quiet_run: QuietRun) -> None:
    assert quiet_run.done.returncode == 0, quiet_run.done.stderr
    left = {file.name for file in quiet_run.folder.iterdir()}
    assert {"notes.txt", "summary.json", "scenario.yaml", "truth_4.csv"} <= left
    assert not {"truth_5.csv", "vehicle_5.yaml", "agent_5.log", "comparison.json", "average_26"} & left


def test_a_folder_without_a_summary_is_left_unchanged(tmp_path: Path) -> None:
    (tmp_path / "vehicle_9.yaml").touch()
    (tmp_path / "fleet.yaml").touch()
    remove_old_run(tmp_path)
    assert len(list(tmp_path.iterdir())) == 2


def test_quiet_prints_only_the_result(quiet_run: QuietRun) -> None:
    assert quiet_run.done.stdout.startswith("platoon, weighted: flown and landed")
    assert "times as fast as real time" in quiet_run.done.stdout


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("nowhere.yaml",), "nowhere.yaml: cannot be read: No such file"),
        ((PLATOON, "--set", "links.peer_loss=1.5"), "--set: links.peer_loss: 1.5"),
        ((PLATOON, "--set", "links.peer_delay=1"), 'did you mean "peer_delay_s"'),
        ((PLATOON, "--out", "/dev/null/x"), "choose another folder with --out"),
    ],
)
def test_bad_input_is_one_line(arguments: tuple[object, ...], text: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_an_unknown_law_is_refused() -> None:
    done = run(PLATOON, "--law", "fastest")
    assert done.returncode == 2
    assert "average_26" in done.stderr


def test_a_failed_flight_is_reported_with_exit_code_1(tmp_path: Path) -> None:
    done = run(PLATOON, "--out", tmp_path, "--quiet", "--set", "timeline[1].timeout_s=1")
    assert done.returncode == 1
    assert "arm not done within 1 s" in done.stdout
    assert read_summary(tmp_path / "summary.json").failure is not None


def test_ctrl_c_lands_and_writes_the_folder(tmp_path: Path) -> None:
    arguments = (PLATOON, "--out", tmp_path, "--set", "timeline[3].for_s=3600")
    with subprocess.Popen(command(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        while "form" not in process.stdout.readline():
            pass
        time.sleep(0.5)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert "interrupted by SIGINT" in printed
    assert errors == ""
    summary = read_summary(tmp_path / "summary.json")
    assert summary.failure == "interrupted by SIGINT"
    assert [event.vehicle for event in summary.events if event.event == "land -> observe"] != []


def test_the_scenario_is_flown_with_ardupilot(tmp_path: Path) -> None:
    settles = ("--law", "cooperative", "--set", "timeline[3].for_s=8")
    done = run(PLATOON, "--out", tmp_path, "--autopilot", "ardupilot", *settles, "--quiet")
    assert done.returncode == 0, done.stdout + done.stderr
    assert load_scenario(tmp_path / "scenario.yaml").stand_in.autopilot is AutopilotKind.ARDUPILOT
    summary = read_summary(tmp_path / "summary.json")
    assert summary.final_error_m is not None and summary.final_error_m < 0.05
    assert "GUIDED" in (tmp_path / "truth_1.csv").read_text(encoding="ascii")
