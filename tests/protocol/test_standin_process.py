"""`sitl autopilot` as a process: help, errors in one line, end, truth file and memory."""

from __future__ import annotations

import signal
import socket
import subprocess
import sys
import time
from itertools import pairwise
from pathlib import Path
from statistics import median

import pytest

from common import until
from processes import free_vehicle_offset, stand_in
from sitl.links.ports import ports_of
from sitl.vehicle.truth import TRUTH_HEADER


def sitl(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "sitl", *arguments], capture_output=True, text=True, timeout=30.0, check=False
    )


def assert_one_line_of(result: subprocess.CompletedProcess[str], *words: str) -> None:
    """A refusal: exit code 2 and one line that says what is wrong."""
    assert result.returncode == 2
    assert len(result.stderr.splitlines()) == 1, result.stderr
    for word in words:
        assert word in result.stderr


def test_help_has_ports_and_exit_codes() -> None:
    result = sitl("autopilot", "--help")
    assert result.returncode == 0
    for words in ("14580+i+K", "--truth", "--seconds", "exit codes:"):
        assert words in result.stdout


@pytest.mark.parametrize("which", ["onboard", "ground_link"])
def test_a_port_in_use_is_refused(which: str) -> None:
    offset = free_vehicle_offset()
    port = getattr(ports_of(1, offset), which)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", port))
        result = sitl("autopilot", "--port-offset", str(offset), "--seconds", "1")
    assert_one_line_of(result, str(port), "--port-offset")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("id: 300\n", ("id", "250")),
        ("stand_in: {airframe: {mas_kg: 1.0}}\n", ("mas_kg", "mass_kg")),
        ("stand_in: {airframe: {hover_thrust_norm: 2}}\n", ("hover_thrust_norm",)),
        ("stand_in: {sensors: perfect}\n", ("sensors",)),
        ("stand_in: {wind: {mean_enu_m_s: [1, 2]}}\n", ("mean_enu_m_s",)),
        ("stand_in: {parameters: {NO_SUCH: 1}}\n", ("NO_SUCH",)),
        ("id: [\n", ("autopilot.yaml",)),
    ],
)
def test_a_bad_file_is_refused(tmp_path: Path, text: str, words: tuple[str, ...]) -> None:
    file = tmp_path / "autopilot.yaml"
    file.write_text(text, encoding="utf-8")
    assert_one_line_of(sitl("autopilot", "--config", str(file)), "autopilot.yaml", *words)


def test_a_missing_file_and_an_id_out_of_range_are_refused(tmp_path: Path) -> None:
    assert_one_line_of(sitl("autopilot", "--config", str(tmp_path / "none.yaml")), "none.yaml")
    assert_one_line_of(sitl("autopilot", "--id", "0"), "--id", "250")


def test_a_truth_file_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    result = sitl(
        "autopilot", "--truth", str(tmp_path / "no" / "truth.csv"), "--port-offset", str(free_vehicle_offset())
    )
    assert_one_line_of(result, "truth.csv")


def written(folder: Path, *ids: int) -> list[str]:
    """A file for each of these vehicles."""
    files = [folder / f"{number}.yaml" for number, _ in enumerate(ids)]
    for file, vehicle_id in zip(files, ids, strict=True):
        file.write_text(f"id: {vehicle_id}\nstart_enu_m: [{vehicle_id}.0, 0.0, 0.0]\n", encoding="utf-8")
    return [str(file) for file in files]


def test_several_vehicles_fly_in_one_process(tmp_path: Path) -> None:
    truths = [str(tmp_path / f"{number}.csv") for number in range(2)]
    offset = str(free_vehicle_offset())
    options = ("--truth", *truths, "--port-offset", offset, "--seconds", "1")
    result = sitl("autopilot", "--config", *written(tmp_path, 1, 2), *options)
    assert result.returncode == 0, result.stderr
    assert [line.split(":")[0] for line in result.stdout.splitlines()][:2] == ["vehicle 1", "vehicle 2"]
    for truth, x_m in zip(truths, ("1.00000", "2.00000"), strict=True):
        rows = Path(truth).read_text(encoding="ascii").splitlines()[1:]
        assert len(rows) >= 10
        assert {row.split(",")[1] for row in rows} == {x_m}


@pytest.mark.parametrize(
    ("ids", "options", "words"),
    [
        ((1, 2), ("--id", "3"), ("--id", "2 vehicles")),
        ((1, 1), (), ("1.yaml", "id")),
        ((1, 2), ("--truth", "truth.csv"), ("--truth", "1 files for 2 vehicles")),
    ],
)
def test_options_that_do_not_suit_several_vehicles_are_refused(
    tmp_path: Path, ids: tuple[int, ...], options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert_one_line_of(sitl("autopilot", "--config", *written(tmp_path, *ids), *options), *words)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_the_process_at_once_with_a_complete_truth_file(tmp_path: Path, number: signal.Signals) -> None:
    with stand_in(tmp_path) as process:
        until(process.truth)
        process.process.send_signal(number)
        assert process.process.wait(5.0) == 0
        assert "Traceback" not in process.log
        text = process.truth_file.read_text(encoding="ascii")
    assert text.startswith(TRUTH_HEADER)
    assert text.endswith("\n")


def test_the_option_seconds_ends_the_process_and_the_truth_has_fifty_rows_a_second(tmp_path: Path) -> None:
    with stand_in(tmp_path, "id: 3\nstart_enu_m: [1.0, 2.0, 0.0]\n", "--id", "1", "--seconds", "2") as process:
        assert process.process.wait(20.0) == 0
        lines = process.truth_file.read_text(encoding="ascii").splitlines()[1:]
    stamps_s = [float(line.split(",")[0]) for line in lines]
    assert median(later - earlier for earlier, later in pairwise(stamps_s)) == pytest.approx(0.02, rel=0.01)
    assert 50 <= len(lines) <= 100  # time in which the machine slept is not flown
    assert stamps_s[-1] == pytest.approx(time.monotonic(), abs=10.0)
    assert lines[0].split(",")[1:4] == ["1.00000", "2.00000", "0.00000"]


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_memory_stays_under_60_mb(tmp_path: Path) -> None:
    with stand_in(tmp_path) as process:
        until(lambda: len(process.truth()) > 200)
        status = Path(f"/proc/{process.process.pid}/status").read_text(encoding="ascii")
    rss_kb = next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))
    assert rss_kb < 60_000
