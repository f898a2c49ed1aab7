"""Flights of `sitl` commands on a real cluster: the same results, Ctrl-C, and a scheduler that is away."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from distributed import Client

from common import ROOT, until
from dask_cluster import Cluster, cluster, known_tasks, running_tasks
from sitl.cli.main import exit_code_of, parser
from sitl.cluster import client, workers_of
from sitl.cluster.task import software
from sitl.compare import flights
from sitl.paper.flights import FlightSubject, Model, PaperPlan
from sitl.paper.flights import fly as fly_plan
from sitl.report.progress import ShareProgress
from sitl.workers import LocalWorkers, all_results

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"
COMPARE = ["compare", str(PLATOON), "--vary", "stand_in.sensors=ideal,default", "--vary", "links.peer_loss=0,0.2"]
COMPARE += ["--seeds", "4", "--seconds", "4", "--quiet"]
GAUNTLET = ["gauntlet", "--flights", "1", "--families", "exchange", "--seed", "7", "--quiet"]
COMMANDS = (COMPARE, GAUNTLET, ["paper", "--quiet"])


@pytest.fixture(autouse=True)
def sources_of_this_moment() -> None:
    """A working tree may be edited while its tests run."""
    software.cache_clear()


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Cluster]:
    (tmp_path / "cluster").mkdir()
    with cluster(tmp_path / "cluster", 2) as made:
        with Client(made.address, set_as_default=False) as to_it:
            to_it.wait_for_workers(2, timeout=60)
        yield made


def no_progress(_share: float) -> None:
    pass


def run(arguments: list[str], out: Path, *more: str) -> int:
    parsed = parser().parse_args([*arguments, "--out", str(out), *more])
    code: int = parsed.chosen.run(parsed)
    return code


@pytest.mark.long
def test_a_comparison_is_the_same_although_a_worker_is_killed(
    two: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def kill_one(_progress: ShareProgress, share: float, more: str = "") -> None:
        if more and share > 0.1 and two.workers[0].poll() is None:
            two.workers[0].kill()
            two.workers[0].wait()

    monkeypatch.setattr(flights, "chunk_size", lambda *_: 2)
    assert run(COMPARE, tmp_path / "here") == 0
    monkeypatch.setattr(ShareProgress, "show", kill_one)
    assert run(COMPARE, tmp_path / "there", "--cluster", two.address) == 0
    assert two.workers[0].poll() == -signal.SIGKILL
    for name in ("compare.csv",):
        assert (tmp_path / "here" / name).read_bytes() == (tmp_path / "there" / name).read_bytes()


@pytest.mark.long
def test_the_flights_of_the_gauntlet_are_the_same(two: Cluster, tmp_path: Path) -> None:
    assert run(GAUNTLET, tmp_path / "here") == run(GAUNTLET, tmp_path / "there", "--cluster", two.address) == 0

    def flown(folder: str) -> dict[str, Any]:
        report: dict[str, Any] = msgspec.json.decode((tmp_path / folder / "gauntlet.json").read_bytes())
        for flight in report["flights"]:
            del flight["cpu_s"]
        return report

    assert flown("here") == flown("there")


def test_flights_of_the_paper_are_the_same(two: Cluster) -> None:
    plans = [PaperPlan(FlightSubject.PLATOON, "weighted", Model.FULL, more=("timeline[3].for_s=4",))]
    (flight,) = all_results(LocalWorkers(), fly_plan, plans, no_progress)
    with workers_of(two.address) as workers:
        (flight_there,) = all_results(workers, fly_plan, plans, no_progress)
    tracks, tracks_there = flight.flight.tracks, flight_there.flight.tracks
    assert all(np.array_equal(tracks[i].position_enu_m, tracks_there[i].position_enu_m) for i in tracks)


def test_ctrl_c_cancels_the_tasks(two: Cluster, tmp_path: Path) -> None:
    arguments = ["compare", str(PLATOON), "--seeds", "3000", "--seconds", "3600", "--out", str(tmp_path / "out")]
    with subprocess.Popen(
        [sys.executable, "-m", "sitl", *arguments, "--cluster", two.address],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        assert process.stderr is not None
        assert "3000 flights" in process.stderr.readline()
        with Client(two.address, set_as_default=False) as to_it:
            until(lambda: sum(to_it.run(running_tasks).values()) == 2, 60.0)
            process.send_signal(signal.SIGINT)
            printed, errors = process.communicate(timeout=60)
            assert to_it.run_on_scheduler(known_tasks) == 0
            until(lambda: sum(to_it.run(running_tasks).values()) == 0, 60.0)
    assert process.returncode == 130, errors
    assert errors == "stopped before any flight was complete: those of a batch end together\n"
    assert printed == ""


@pytest.mark.parametrize("arguments", COMMANDS, ids=lambda arguments: arguments[0])
def test_a_scheduler_that_is_away_ends_each_command_with_one_line(
    arguments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(client, "ANSWERS_WITHIN_S", 0.5)
    assert exit_code_of("sitl", lambda: run(arguments, tmp_path, "--cluster", "127.0.0.1:1")) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = [line for line in printed.err.splitlines() if " % " not in line]
    assert line.startswith("no Dask scheduler answers at tcp://127.0.0.1:1; start one there with `dask scheduler`, or")
    assert list(tmp_path.iterdir()) == []
