"""Switching topologies: random starts, what is counted of a flight, and the command's figures."""

from math import dist
from pathlib import Path

import numpy as np
import pytest

from companion.config import RangeNeighbours
from companion.core.formation import weighted
from sitl.switching.figure import save_switching
from sitl.switching.starts import APART_M, random_start
from sitl.switching.summary import in_a_table, summarize
from sitl.switching.topology import BoolArray, Spectra, Topology, losses, mutual


def graph(n: int, *edges: tuple[int, int]) -> BoolArray:
    matrix = np.zeros((n, n), dtype=np.bool_)
    for a, b in edges:
        matrix[a - 1, b - 1] = matrix[b - 1, a - 1] = True
    return matrix


def test_a_start_is_connected_and_nobody_is_near_another() -> None:
    for seed in range(20):
        places = random_start(6, 3.0, seed).places_enu_m
        apart = [dist(a, b) for i, a in places.items() for j, b in places.items() if i < j]
        assert min(apart) >= APART_M
        reached = {1}
        for _ in places:
            reached |= {j for i in reached for j in places if dist(places[i], places[j]) <= 3.0}
        assert reached == set(places)


def test_a_start_is_the_same_every_time() -> None:
    assert random_start(5, 3.0, 7) == random_start(5, 3.0, 7)
    assert random_start(5, 3.0, 7) != random_start(5, 3.0, 8)


def test_a_start_that_cannot_be() -> None:
    with pytest.raises(ValueError, match=r"no start of 40 vehicles with a range of 0\.5 m"):
        random_start(40, 0.5, 1)


def test_a_start_becomes_a_scenario_with_live_neighbours() -> None:
    start = random_start(6, 3.0, 1)
    scenario = start.scenario("average_26", RangeNeighbours(range_m=3.0, hysteresis_m=0.3))
    assert scenario.fleet.law.name == "average_26"
    assert scenario.fleet.neighbours == RangeNeighbours(range_m=3.0, hysteresis_m=0.3)
    assert dist(scenario.reference.point_enu_m[:2], start.places_enu_m[1][:2]) >= 2.0


def test_lambda_min_of_the_papers_own_graph_and_of_a_vehicle_cut_off() -> None:
    spectra = Spectra(weighted(), 4)
    assert spectra.lambda_min(graph(4, (1, 2), (1, 3), (2, 3), (2, 4), (3, 4))) == pytest.approx(0.1979, abs=5e-5)
    assert spectra.lambda_min(graph(4, (1, 2), (3, 4))) is None


def test_an_edge_counts_where_both_heed_each_other_and_is_lost_once() -> None:
    one_sided = np.zeros((3, 2, 2), dtype=np.bool_)
    one_sided[:, 0, 1] = True
    assert losses(mutual(one_sided)) == 0
    there = np.stack([graph(3, (1, 2), (2, 3)), graph(3, (1, 2)), graph(3, (1, 2), (2, 3)), graph(3)])
    assert losses(there) == 3


def topology(law: str, cut_off_s: float | None, edges_lost: int = 0) -> Topology:
    return Topology(
        law=law,
        seed=1,
        hysteresis_m=0.0,
        edges_lost=edges_lost,
        lambda_min=0.2,
        cut_off_s=cut_off_s,
        connected_at_the_end=cut_off_s is None,
        final_error_m=0.1,
        closest_m=1.0,
    )


def test_the_summary_counts_each_law_by_itself(tmp_path: Path) -> None:
    flown = [topology("weighted", None, 4), topology("weighted", 2.0), topology("average_22", 1.0)]
    laws = {summary.law: summary for summary in summarize(flown)}
    assert (laws["weighted"].starts, laws["weighted"].connected, laws["weighted"].edges_lost_mean) == (2, 1, 2.0)
    assert (laws["average_22"].connected, laws["average_22"].cut_off_median_s) == (0, 1.0)
    assert "50.0 %" in in_a_table(summarize(flown))
    save_switching(tmp_path / "s.png", flown, 30.0, "three starts")
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
