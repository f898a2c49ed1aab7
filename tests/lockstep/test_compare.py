"""`sitl compare` from the command line and from Python: folder, agreement with the agents, exit codes, Ctrl-C."""

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
from sitl.api import compare
from sitl.compare import flights
from sitl.compare.command import run as run_compare
from sitl.compare.options import CompareOptions
from sitl.compare.plan import plan_of
from sitl.report.progress import ShareProgress
from sitl.workers import reporting_to

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "sitl", *map(str, arguments)]


def sitl(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*arguments), capture_output=True, text=True, timeout=120, check=False)


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / "compare.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def test_two_laws_on_two_graphs_under_two_conditions(tmp_path: Path) -> None:
    """From the command line with a check by the agents, and from Python in one process: the same figures."""
    names = ("--laws", "weighted,cooperative", "--graphs", "chain,grid", "--conditions", "ideal,delay_loss")
    done = sitl("compare", *names, "--vehicles", 4, "--seeds", 2, "--seconds", 4, "--lockstep", 1, "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    printed = done.stdout.splitlines()
    assert printed[0] == "16 flights of 4 vehicles, 4 s each"
    assert "1 flights again by the agents: 5 of 5 figures agree" in done.stdout or "6 of 6 figures agree" in done.stdout
    assert printed[-1] == f"results in {tmp_path}"
    rows = rows_of(tmp_path)
    assert len(rows) == 16 and {row["flown_by"] for row in rows} == {"batch"}
    content: dict[str, Any] = msgspec.json.decode((tmp_path / "compare.json").read_bytes())
    assert content["complete"] and "--lockstep 1" in content["command"]
    again = compare(
        ["weighted", "cooperative"],
        graphs=["chain", "grid"],
        conditions=["ideal", "delay_loss"],
        vehicles=[4],
        seeds=2,
        seconds=4,
        processes=1,
        quiet=True,
    )
    assert [{key: "" if value is None else str(value) for key, value in row.items()} for row in again.flights] == rows
    assert len({row["rms_m"] for row in rows}) == 16, "each flight has its own ticks and losses"
    assert again.to_pandas().shape == (16, len(rows[0]))


def test_a_scenario_with_varied_keys(tmp_path: Path) -> None:
    varied = ("stand_in.sensors=ideal,default", "stand_in.airframe.attitude=rigid_body,instant")
    options = CompareOptions(scenario=PLATOON, varied=varied, seeds=2, seconds=4.0, out=tmp_path, quiet=True)
    assert run_compare(options) == 0
    rows = rows_of(tmp_path)
    assert [(row["stand_in.sensors"], row["stand_in.airframe.attitude"], row["seed"]) for row in rows] == [
        (sensors, attitude, seed)
        for sensors in ("ideal", "default")
        for attitude in ("rigid_body", "instant")
        for seed in ("1", "2")
    ]


def test_a_neighbour_that_lies_moves_the_others() -> None:
    """A batch cannot fly it: the agents do."""
    options = CompareOptions(
        laws=["cooperative"], graphs=["chain"], conditions=["ideal", "lying"], vehicles=[4], seeds=1, seconds=6.0
    )
    truthful, lying = plan_of(options, lambda _share: None).flights
    assert lying.by_agents
    honest = flights.fly_in_a_batch([truthful], 6.0)[0]
    shares: list[float] = []
    with reporting_to(shares.append):
        misled = flights.fly_by_agents(lying, 6.0)
    assert len(shares) > 5 and shares == sorted(shares) and 0.0 < shares[0] < 0.2 and 0.7 < shares[-1] <= 1.0
    assert honest.final_error_m is not None and misled.final_error_m is not None
    assert honest.final_error_m < 0.01 < 0.9 < misled.final_error_m


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (("compare", "nowhere.yaml"), "nowhere.yaml: cannot be read: No such file"),
        (("compare", PLATOON, "--set", "links.peer_loss=1.5"), "--set: links.peer_loss: 1.5"),
        (("compare", PLATOON, "--out", "/dev/null/x"), "choose another folder with --out"),
        (("sweep", PLATOON, "--vary", "links.peer_loss=0,1"), "`sitl sweep` is now `sitl compare --vary ...`"),
        (("study", "--full"), "`sitl study` is now `sitl compare`"),
        (("switching",), "`sitl switching` is now `sitl compare --graphs range`"),
    ],
)
def test_bad_input_and_old_names_are_one_line(arguments: tuple[object, ...], text: str) -> None:
    done = sitl(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert text in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_ctrl_c_ends_all_processes_with_one_line(tmp_path: Path) -> None:
    """The workers get the signal too, as in a terminal."""
    arguments = (PLATOON, "--seeds", 3000, "--seconds", 3600, "--out", tmp_path / "out")
    with subprocess.Popen(
        command("compare", *arguments),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        assert process.stderr is not None
        assert "flying   0%   3000 flights   " in process.stderr.readline()
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    assert process.returncode == 130, errors
    assert errors == "stopped before any flight was complete: those of a batch end together\n"
    assert not (tmp_path / "out").exists()
    assert printed == ""


def test_ctrl_c_keeps_complete_flights(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(_progress: ShareProgress, _share: float, more: str = "") -> None:
        if "complete" in more:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(ShareProgress, "show", interrupt)
    monkeypatch.setattr(flights, "chunk_size", lambda *_: 5)
    options = CompareOptions(
        scenario=PLATOON, laws=["weighted", "cooperative"], seeds=1000, seconds=4.0, out=tmp_path, processes=1
    )
    assert run_compare(options) == 130
    rows = rows_of(tmp_path)
    assert 5 <= len(rows) < 500
    assert [int(row["seed"]) for row in rows] == list(range(1, len(rows) + 1))
    content: dict[str, Any] = msgspec.json.decode((tmp_path / "compare.json").read_bytes())
    assert not content["complete"]
    assert "Stopped before the end" in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "stopped before the end" in capsys.readouterr().out
