"""`sitl paper`: shortened flights, and the command line."""

import os
import signal
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from companion.config.law import LawName
from sitl.paper.aggregation_claims import broken_edges, has_gathered, left_for_good_s
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
    reported_matrix,
    topology_at,
)
from sitl.paper.graphs import RING_LED_BY_1, RING_LED_BY_2, printed_matrix
from sitl.paper.report import ideal_figures
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


def test_ctrl_c_ends_promptly_without_a_report(tmp_path: Path) -> None:
    """The workers get the signal too, as in a terminal."""
    with subprocess.Popen(
        command("--out", tmp_path), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stderr is not None
        assert "theory" in process.stderr.readline()
        os.killpg(process.pid, signal.SIGINT)
        printed, errors = process.communicate(timeout=5)
    assert process.returncode == 130
    assert (printed, errors) == ("", "stopped; no report was written\n")
    assert list(tmp_path.iterdir()) == []
