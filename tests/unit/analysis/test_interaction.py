"""Spectrum and margins against independently computed figures, predictions against known chains."""

import json
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from common import ROOT
from companion.analysis.interaction import (
    couple,
    eigenvalues,
    interaction_matrix,
    time_to_shrink_s,
)
from companion.analysis.prediction import DIVERGED_M, errors_over_time, settled_after_s, transient_peak
from companion.analysis.response import TICK_S, LinearModel, reached_from, settled_prcs
from companion.cli.main import main
from companion.core.consensus.law import next_prc
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.tools.analysis import analyse
from companion.tools.analysis_report import report, verdict
from companion.tools.subject import load_subject
from companion.types.formation import Gains
from companion.types.notices import Code
from tests.helpers.closed_forms import fed_forward, mode_eigenvalues, mode_figures
from tests.helpers.laws import average_22, average_26, law_of, weighted

SCENARIOS = ROOT / "config" / "scenarios"
K = Gains(1.39, 1.2)


def chain(n: int) -> dict[int, list[int]]:
    return {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}


def grid(n: int) -> dict[int, list[int]]:
    cells = [(x, y) for x in range(n) for y in range(n)]
    number = {cell: index + 1 for index, cell in enumerate(cells)}
    steps = ((1, 0), (-1, 0), (0, 1), (0, -1))
    return {number[x, y]: [number[x + a, y + b] for a, b in steps if (x + a, y + b) in number] for x, y in cells}


@pytest.mark.parametrize(
    ("graph", "alpha", "expected"),
    [
        (chain(4), 0, 0.079),
        (chain(4), 1, 0.182),
        (chain(4), 2, 0.288),
        (chain(4), 8, 0.382),
        (chain(16), 0, 0.005),
        (chain(16), 1, 0.019),
        (chain(16), 2, 0.039),
        (chain(16), 8, 0.223),
        (grid(10), 0, 0.0015),
        (grid(10), 1, 0.0123),
        (grid(10), 2, 0.0327),
        (grid(10), 8, 0.2072),
    ],
)
def test_lambda_min_by_exponent(graph: dict[int, list[int]], alpha: float, expected: float) -> None:
    digits = 5e-4 if expected > 0.05 or len(graph) < 50 else 5e-5
    assert eigenvalues(interaction_matrix(graph, {1}, weighted(K, alpha)))[0] == pytest.approx(expected, abs=digits)


def test_lambda_min_at_a_large_exponent() -> None:
    assert eigenvalues(interaction_matrix(chain(6), {1}, weighted(K, 16.0)))[0] == pytest.approx(
        (3 - sqrt(5)) / 2, abs=0.01
    )


@st.composite
def connected_graphs(draw: st.DrawFn) -> dict[int, list[int]]:
    """A random tree with random edges added."""
    n = draw(st.integers(1, 9))
    edges = {(draw(st.integers(1, i - 1)), i) for i in range(2, n + 1)}
    edges |= draw(st.sets(st.tuples(st.integers(1, n), st.integers(1, n)).filter(lambda e: e[0] < e[1]), max_size=9))
    graph: dict[int, list[int]] = {i: [] for i in range(1, n + 1)}
    for a, b in sorted(edges):
        graph[a].append(b)
        graph[b].append(a)
    return graph


@settings(max_examples=200)
@given(connected_graphs(), st.data(), st.floats(0, 8))
def test_lemmas_corollary_2_and_proposition_2_hold(
    graph: dict[int, list[int]], data: st.DataObject, alpha: float
) -> None:
    leaders = data.draw(st.sets(st.sampled_from(sorted(graph)), min_size=1))
    matrix = interaction_matrix(graph, leaders, weighted(K, alpha))
    spectrum = np.linalg.eigvals(matrix)
    assert np.abs(spectrum.imag).max() < 1e-6  # Lemma 2
    assert spectrum.real.min() > 0.0  # Lemma 1
    assert spectrum.real.max() <= 3.0 + 1e-9  # Corollary 2
    if len(leaders) == 1:
        paper, average = (interaction_matrix(graph, leaders, law) for law in (weighted(K, 1.0), average_22(K)))
        assert eigenvalues(paper)[0] >= eigenvalues(average)[0] - 1e-9  # Proposition 2, against eq. 22


@settings(max_examples=100)
@given(connected_graphs(), st.data(), st.floats(0, 8), st.floats(0, 0.95), st.booleans())
def test_modes_with_feedforward_are_real_and_positive(
    graph: dict[int, list[int]], data: st.DataObject, alpha: float, feedforward: float, leader_heeds: bool
) -> None:
    leaders = data.draw(st.sets(st.sampled_from(sorted(graph)), min_size=1))
    law = law_of(K, alpha, leader_heeds, feedforward)
    coupling, modes = couple(graph, leaders, law), mode_eigenvalues(graph, leaders, law)
    effective = np.linalg.solve(np.eye(len(graph)) - fed_forward(graph, leaders, law), coupling.G)
    spectrum = np.linalg.eigvals(effective)
    assert np.abs(spectrum.imag).max() < 1e-4
    assert modes == pytest.approx(np.sort(spectrum.real), abs=1e-4)
    assert modes[0] > 0.0
    assert eigenvalues(coupling.G) == pytest.approx(np.sort(np.linalg.eigvals(coupling.G).real), abs=1e-5)


@given(connected_graphs(), st.data())
def test_settled_prcs_equal_the_result_of_algorithm_1(graph: dict[int, list[int]], data: st.DataObject) -> None:
    leaders = data.draw(st.sets(st.sampled_from(sorted(graph))))  # possibly no leader: p = n then
    n = len(graph)
    prcs = {i: 1 if i in leaders else n for i in graph}
    for _ in range(n + 1):
        prcs = {i: next_prc(i in leaders, (prcs[j] for j in graph[i]), n) for i in graph}
    assert settled_prcs(graph, leaders) == prcs


def test_proposition_2_does_not_hold_against_eq_26() -> None:
    graph = {1: [2, 3], 2: [1, 3, 4], 3: [1, 2, 4], 4: [2, 3]}
    assert eigenvalues(interaction_matrix(graph, {1}, average_26(K)))[0] == pytest.approx(0.2324, abs=5e-5)
    assert eigenvalues(interaction_matrix(graph, {1}, weighted(K, 1.0)))[0] == pytest.approx(0.1979, abs=5e-5)


@given(st.floats(0.001, 3.0))
def test_rate_is_proportional_to_lambda_with_the_papers_gains(eigenvalue: float) -> None:
    assert mode_figures(K, eigenvalue).rate_1_s == pytest.approx(0.6 * eigenvalue)  # Corollary 1, true below 3.861
    assert mode_figures(K, eigenvalue).damping == pytest.approx(0.509 * sqrt(eigenvalue), rel=1e-3)


def test_corollary_1_fails_for_an_overdamped_mode() -> None:
    assert mode_figures(K, 4.5).rate_1_s < 0.6 * 4.5


def test_delay_margins_of_one_mode() -> None:
    assert mode_figures(K, 3.0).delay_margin_s == pytest.approx(0.34, abs=0.005)
    assert mode_figures(K, 0.0789).delay_margin_s == pytest.approx(0.81, abs=0.04)


def test_matrix_of_a_single_vehicle() -> None:
    assert interaction_matrix({7: []}, {7}, weighted(K, 1.0)).tolist() == [[1.0]]
    assert settled_prcs({7: []}, {7}) == {7: 1}


def test_vehicles_with_a_path_to_a_leader() -> None:
    assert reached_from({1: [2], 2: [1], 3: []}, {1}) == {1, 2}


@pytest.mark.parametrize(
    ("law", "largest", "smallest", "settles_s"),
    [
        (average_22(K), 1.8903, 1.2058, 68.46),
        (average_26(K), 2.1845, 1.0259, 44.82),
        (weighted(K, 1.0), 1.8703, 1.1081, 32.80),
    ],
)
def test_predictions_for_the_platoon(law: NeighbourFeedback, largest: float, smallest: float, settles_s: float) -> None:
    """The expected figures are of the continuous model, integrated in steps of 0.5 ms."""
    errors_m = stepped(4, law, 120.0)
    distances_m = 1.5 + errors_m[:, :-1, 0] - errors_m[:, 1:, 0]
    assert distances_m.max() == pytest.approx(largest, abs=0.001)
    assert distances_m.min() == pytest.approx(smallest, abs=0.001)
    assert settled_after_s(errors_m, 0.1) == pytest.approx(settles_s, abs=0.05)


def stepped(n: int, law: NeighbourFeedback, duration_s: float) -> np.ndarray:
    """Errors of a chain whose reference steps by 1 m."""
    return errors_over_time(couple(chain(n), {1}, law), np.full((n, 1), -1.0), LinearModel(), duration_s)


@pytest.mark.parametrize(
    ("law", "largest", "smallest", "settles_s"),
    [
        (weighted(Gains(1.0, 2.0)), 1.75, 1.19, 166.0),
        (law_of(Gains(1.0, 2.0), 1.0, True, 0.9), 1.58, 1.43, 19.0),
        (law_of(Gains(1.0, 2.0), 8.0, True, 0.9), 1.54, 1.47, 6.0),
        (law_of(Gains(1.0, 2.0), 8.0, True, 0.8), 1.57, 1.43, 8.0),
    ],
)
def test_predictions_for_a_chain_of_16(
    law: NeighbourFeedback, largest: float, smallest: float, settles_s: float
) -> None:
    errors_m = stepped(16, law, 200.0)
    distances_m = 1.5 + errors_m[:, :-1, 0] - errors_m[:, 1:, 0]
    assert distances_m.max() == pytest.approx(largest, abs=0.01)
    assert distances_m.min() == pytest.approx(smallest, abs=0.01)
    assert settled_after_s(errors_m, 0.1) == pytest.approx(settles_s, abs=0.5)


def test_long_chain_collides_with_a_large_exponent_alone() -> None:
    errors_m = stepped(16, weighted(K, 4.0), 120.0)
    assert 1.5 + (errors_m[:, :-1, 0] - errors_m[:, 1:, 0]).min() < 0.0
    assert transient_peak(errors_m) > 10.0


def test_error_inside_only_at_the_end_has_not_settled() -> None:
    errors_m = np.full((500, 2, 3), 0.01)  # 10 s
    errors_m[: round(9.0 / TICK_S)] = 0.3
    assert settled_after_s(errors_m, 0.1) is None
    errors_m[round(7.9 / TICK_S) :] = 0.01
    assert settled_after_s(errors_m, 0.1) == pytest.approx(7.9)


def test_transient_peak_is_one_for_zero_errors() -> None:
    assert transient_peak(np.zeros((5, 3, 2))) == 1.0


def test_prediction_ends_when_errors_diverge() -> None:
    errors_m = errors_over_time(
        couple(chain(3), {1}, weighted(Gains(10.0, 10.0))), np.ones((3, 3)), LinearModel(), 400.0
    )
    assert np.isfinite(errors_m).all()
    assert DIVERGED_M < np.abs(errors_m).max() < 100.0 * DIVERGED_M
    assert settled_after_s(errors_m, 0.1) is None


def test_small_error_settles_at_once() -> None:
    assert time_to_shrink_s(0.5, 0.0, 0.1) == 0.0


# ---------------------------------------------------------------- companion analyze


def test_analyze_prints_the_platoon(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(SCENARIOS / "platoon.yaml"), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["laws"]["weighted"]["lambda_min"] == pytest.approx(0.1818, abs=5e-5)
    assert figures["laws"]["average_22"]["rate_1_s"] == pytest.approx(0.6 * 0.0789, abs=5e-5)
    assert figures["laws"]["average_26"]["G"][0] == [1.0, 0.0, 0.0, 0.0]
    assert Code.BADLY_DAMPED in [finding["code"] for finding in figures["verdict"]]
    assert main(["analyze", str(SCENARIOS / "platoon.yaml")]) == 0
    assert "0.1818" in capsys.readouterr().out


def changed(tmp_path: Path, **changes: object) -> Path:
    data = yaml.safe_load((SCENARIOS / "platoon.yaml").read_text())
    data["fleet"].update(changes)
    ids = {vehicle["id"] for vehicle in data["fleet"]["vehicles"]}
    data["starts_enu_m"] = {i: start for i, start in data["starts_enu_m"].items() if i in ids}
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "scenario.yaml"


@pytest.mark.parametrize(
    "neighbours",
    [{"kind": "edges", "edges": [[1, 2], [3, 4]]}, {"kind": "range", "range_m": 0.5}, {"kind": "edges", "edges": []}],
)
def test_formation_without_a_path_to_a_leader_is_reported(
    tmp_path: Path, neighbours: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(tmp_path, neighbours=neighbours)
    assert main(["analyze", str(path)]) == 1
    assert "cannot converge" in capsys.readouterr().out


def test_neighbours_out_of_range_are_reported(tmp_path: Path) -> None:
    analysis = analyse(load_subject(changed(tmp_path, neighbours={"kind": "range", "range_m": 1.7})))
    assert analysis.laws["weighted"].stays_in_range is False
    assert Code.NEIGHBOURS_OUT_OF_RANGE in {finding.code for finding in verdict(analysis)}


def test_single_vehicle_is_analyzed(tmp_path: Path) -> None:
    path = changed(
        tmp_path,
        vehicles=[{"id": 1, "role": "leader", "slot_enu_m": [0.0, 0.0, 0.0]}],
        neighbours={"kind": "edges", "edges": []},
    )
    analysis = analyse(load_subject(path))
    assert analysis.laws["weighted"].lambda_min == 1.0
    assert "verdict" in report(analysis)


def test_invalid_file_is_reported_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(changed(tmp_path, law={"parameters": {"exponent": 99}}))]) == 2
    error = capsys.readouterr().err
    assert "fleet.law.parameters.exponent: 99" in error
    assert error.count("\n") == 1
