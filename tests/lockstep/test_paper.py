"""`sitl paper`: shortened flights, and the command line."""

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import msgspec
import numpy as np
import pytest

from companion.config.law import LawName
from sitl.paper.aggregation_claims import broken_edges, has_gathered, left_for_good_s
from sitl.paper.command import run_paper
from sitl.paper.flights import (
    PATIENT,
    Book,
    FlightSubject,
    FlownPlan,
    Model,
    NoFormationError,
    PaperPlan,
    fly,
    leaderships,
    paper_plans,
    reported_matrix,
    topology_at,
)
from sitl.paper.graphs import RING_LED_BY_1, RING_LED_BY_2, matrix_claims, printed_matrix
from sitl.paper.report import ideal_figures
from sitl.report.claim import Claim
from sitl.report.progress import ShareProgress
from sitl.workers import LocalWorkers

SHORT = "timeline[3].for_s=6"


@cache
def flown(subject: FlightSubject, law: LawName, *more: str) -> FlownPlan:
    return fly(PaperPlan(subject, law, Model.IDEAL, more=more))


@pytest.mark.parametrize("law", ["weighted", "average_22", "average_26"])
def test_the_agents_agree_with_the_equations(law: LawName) -> None:
    flight = flown(FlightSubject.PLATOON, law, SHORT)
    of_agents = flight.figures
    of_equations = ideal_figures(flight, delay_s=0.01)
    assert set(of_equations.max_distance_m) == {"1-2", "2-3", "3-4"}
    for pair, largest_m in of_equations.max_distance_m.items():
        assert of_agents.max_distance_m[pair] == pytest.approx(largest_m, abs=0.005)


def test_the_leader_is_soon_alone_under_eq_26_but_not_under_the_weighted_law() -> None:
    average = flown(FlightSubject.AGGREGATION, "average_26", PATIENT, SHORT)
    weighted = flown(FlightSubject.AGGREGATION, "weighted", SHORT)
    assert 0.05 < left_for_good_s(average) < 0.5
    assert not has_gathered(average)
    assert left_for_good_s(weighted) == float("inf")
    assert broken_edges(weighted).startswith("1-2 from")


def test_reported_matrices_are_those_of_the_paper_during_leader_changes() -> None:
    steps = [f"timeline[{number}].for_s=1" for number in (3, 4, 5, 6, 7, 8)]
    flight = flown(FlightSubject.FIGURE_8, "weighted", *steps)
    spans = leaderships(flight)
    assert [lead.leader_id for lead in spans] == [1, 2, 1, 2, 1, 2]
    for lead in spans:
        printed = printed_matrix(RING_LED_BY_1 if lead.leader_id == 1 else RING_LED_BY_2)
        assert reported_matrix(flight, topology_at(flight.topology, lead.settled_s)) == pytest.approx(printed)
        assert lead.settled_s - lead.from_s < 0.2


def test_measuring_a_flight_without_formation_gives_the_reason() -> None:
    flight = flown(FlightSubject.PLATOON, "weighted", "timeline[1].timeout_s=1")
    assert flight.formation is None
    with pytest.raises(NoFormationError, match="arm not done within 1 s"):
        _ = flight.flight


def test_flights_in_worker_processes_are_the_same() -> None:
    plans = [PaperPlan(FlightSubject.PLATOON, law, Model.IDEAL, more=(SHORT,)) for law in ("weighted", "average_22")]
    with LocalWorkers(2).running(fly, plans) as flights:
        assert flights.wait(60.0)
        assert flights.share_done == 1.0
        results = flights.results()
    book = Book(results)
    for plan in plans:
        tracks = book.one(plan.subject, plan.law, plan.model).flight.tracks
        here = flown(plan.subject, plan.law, SHORT).tracks
        assert all(np.array_equal(tracks[i].position_enu_m, here[i].position_enu_m) for i in here)
    with pytest.raises(LookupError):
        book.one(FlightSubject.PLATOON, "average_26", Model.IDEAL)


# ---------------------------------------------------------------- the command line


def command(*arguments: object) -> list[str]:
    return [sys.executable, "-m", "sitl", "paper", *map(str, arguments)]


@pytest.mark.parametrize("folder", ["/dev/null/x", "/proc/x"])
def test_a_folder_that_cannot_be_written_is_one_line(folder: str) -> None:
    done = subprocess.run(command("--out", folder), capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "choose another folder with --out" in done.stderr
    assert len(done.stderr.splitlines()) == 1


def test_ctrl_c_before_anything_is_finished_is_one_line(tmp_path: Path) -> None:
    """The workers get the signal too, as in a terminal."""
    with subprocess.Popen(
        command("--out", tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        assert "quiet core" in process.stderr.readline()
        assert "theory" in process.stderr.readline()
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert (printed, errors) == ("", "stopped before anything was finished; no report was written\n")
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_keeps_what_is_finished(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the theory one claim; of the flights all of the platoon with perfect sensors, and no figure of eight."""
    laws: tuple[LawName, ...] = ("weighted", "average_22", "average_26")
    plans = [
        PaperPlan(FlightSubject.PLATOON, law, model, more=(SHORT,))
        for law in laws
        for model in (Model.IDEAL, Model.FULL)
    ]
    finished = matrix_claims()[:1]

    def theory(_full: bool, show: Callable[[float], None]) -> Iterator[Claim]:
        yield from finished
        while True:
            time.sleep(0.2)
            show(0.5)

    def interrupt(_progress: ShareProgress, _share: float, more: str = "") -> None:
        if more.endswith("flights 100%"):
            os.kill(os.getpid(), signal.SIGINT)

    every = paper_plans(full=False)
    monkeypatch.setattr("sitl.paper.theorems.theory_claims", theory)
    monkeypatch.setattr("sitl.paper.flights.paper_plans", lambda _full: plans)
    monkeypatch.setattr("sitl.paper.flights.Book", lambda flown, _plans: Book(flown, every))
    monkeypatch.setattr(ShareProgress, "show", interrupt)
    assert run_paper(argparse.Namespace(out=tmp_path, quiet=True, cluster=None, full=False)) == 130
    content = msgspec.json.decode((tmp_path / "claims.json").read_bytes())
    ids = {claim["id"] for claim in content["claims"]}
    assert {finished[0].id, "fig-5-faster"} <= ids
    assert {"lemma-1", "figure_8.png"} <= set(content["missing"])
    assert not ids & set(content["missing"])
    assert (tmp_path / "figure_5.png").exists() and not (tmp_path / "figure_8.png").exists()
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "Incomplete: stopped before the end.</b> Not finished:" in page
    assert 'src="figure_5.png"' in page and 'src="figure_8.png"' not in page
