"""String gain, transient peak and delay margin against closed forms and against the prediction."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import ROOT
from companion.analysis.interaction import Coupling, couple
from companion.analysis.margins import (
    delay_margin_with_lag_s,
    is_stable,
    string_gains,
)
from companion.analysis.prediction import errors_over_time, worst_transient_peak
from companion.analysis.response import LinearModel, flown_model
from companion.assembly import flyable_problems
from companion.cli.main import main
from companion.config.file import convert
from companion.config.fleet import FleetConfig
from companion.config.reference import Reference
from companion.laws._neighbour_feedback import NeighbourFeedback
from companion.tools.analysis import analyse
from companion.tools.analysis_report import report, verdict
from companion.tools.subject import load_subject
from companion.types.formation import PAPER_GAINS, Gains
from companion.types.notices import Code
from tests.helpers.closed_forms import mode_figures
from tests.helpers.laws import average_22, average_26, cooperative, law_of, weighted

SCENARIOS = ROOT / "config" / "scenarios"
K = Gains(1.39, 1.2)
FED_FORWARD = law_of(Gains(1.0, 2.0), 1.0, True, 0.9)
COOPERATIVE = law_of(Gains(1.0, 2.5), 8.0, True, 0.9)
ALONE = law_of(Gains(1.0, 2.0), 1.0, False, 0.9)
IDEAL = LinearModel(0.0, 0.0, 0.0)
LAWS = [COOPERATIVE, weighted(), average_22(), average_26(), FED_FORWARD, ALONE]


def chain(n: int) -> dict[int, list[int]]:
    return {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}


def chained(n: int, law: NeighbourFeedback) -> Coupling:
    return couple(chain(n), {1}, law)


# ---------------------------------------------------------------- string gain


def test_one_hop_gain_equals_the_closed_form() -> None:
    """(k2 s + k1) / (s^2 + k2 s + k1) of a follower behind a leader."""
    omega = np.linspace(0.01, 10.0, 200_000)
    s = 1j * omega
    hop = np.abs((1.2 * s + 1.39) / (s * s + 1.2 * s + 1.39))
    gains = string_gains(chained(2, weighted(K)), IDEAL)
    assert gains is not None
    assert gains.per_hop == gains.to_last == pytest.approx(hop.max(), rel=1e-5)
    assert gains.per_hop_rad_s == pytest.approx(omega[hop.argmax()], rel=1e-2)


def test_peak_between_grid_points_is_found() -> None:
    coupling = chained(16, average_22(K))
    gains = string_gains(coupling, LinearModel())
    assert gains is not None
    omega = np.geomspace(0.02, 5.0, 6000)
    swings = np.abs(np.array([coupling.loop.response(float(w), LinearModel()) for w in omega]))
    assert gains.to_last == pytest.approx((swings[:, -1] / swings[:, 0]).max(), rel=2e-3)
    heard = np.where(swings[:, :-1] > 1e-6 * swings[:, :1], swings[:, 1:] / swings[:, :-1], 0.0)
    assert gains.per_hop == pytest.approx(heard.max(), rel=2e-3)


@pytest.mark.parametrize("law", LAWS)
def test_gain_is_one_at_low_frequencies(law: NeighbourFeedback) -> None:
    assert np.abs(chained(5, law).loop.response(1e-4, LinearModel())) == pytest.approx(np.ones(5), abs=1e-4)


def test_response_equals_the_steady_state_of_the_prediction() -> None:
    """The reference oscillates: the leader's error is y - r."""
    law, omega, model = weighted(K), 0.7, LinearModel()
    coupling = chained(3, law)
    swung = np.abs(coupling.loop.response(omega, model))
    amplitude = forced(coupling, model, omega)
    assert amplitude == pytest.approx(swung, rel=0.03)


def forced(coupling: Coupling, model: LinearModel, omega: float) -> np.ndarray:
    """Steady-state amplitudes of y'' = lagged and delayed u, in small steps."""
    dt, gains = 0.002, coupling.law.gains
    y = v = a = np.zeros(len(coupling.G))
    waiting = [y] * round(model.delay_s / dt)
    largest = np.zeros_like(y)
    for k in range(60_000):
        r, dr = np.sin(omega * k * dt), omega * np.cos(omega * k * dt)
        error = coupling.G @ (gains.position_1_s2 * y + gains.velocity_1_s * v)
        waiting.append(-(error - (gains.position_1_s2 * r + gains.velocity_1_s * dr) * coupling.is_leader))
        a = a + (waiting.pop(0) - a) * dt / model.attitude_lag_s
        y, v = y + v * dt, v + a * dt
        if k > 50_000:
            largest = np.maximum(largest, np.abs(y))
    return largest


def test_cooperative_law_has_smaller_string_gains_than_the_papers_laws() -> None:
    paper, cooperating = (string_gains(chained(16, law), LinearModel()) for law in (weighted(), COOPERATIVE))
    assert paper is not None
    assert cooperating is not None
    assert paper.to_last > 10.0
    assert cooperating.to_last < 2.0
    assert cooperating.per_hop < 1.1


def test_no_string_gain_when_all_vehicles_are_leaders() -> None:
    assert string_gains(couple(chain(3), {1, 2, 3}, weighted()), LinearModel()) is None
    assert string_gains(chained(1, cooperative()), LinearModel()) is None


# ---------------------------------------------------------------- delay margin


@pytest.mark.parametrize("model", [LinearModel(), flown_model(link_s=0.1)], ids=["lag", "flown"])
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("n", [1, pytest.param(4, marks=pytest.mark.long), 9])
def test_prediction_diverges_only_above_the_delay_margin(n: int, law: NeighbourFeedback, model: LinearModel) -> None:
    coupling = chained(n, law)
    margin_s = delay_margin_with_lag_s(coupling, model)
    assert not grows(coupling, replace(model, delay_s=0.98 * margin_s))
    assert grows(coupling, replace(model, delay_s=1.04 * margin_s))
    assert is_stable(coupling, replace(model, delay_s=0.97 * margin_s))
    assert not is_stable(coupling, replace(model, delay_s=1.1 * margin_s))


def grows(coupling: Coupling, model: LinearModel) -> bool:
    start_m = np.linspace(-0.3, 1.0, len(coupling.G))[:, np.newaxis]
    errors_m = np.abs(errors_over_time(coupling, start_m, model, 240.0)).max(axis=(1, 2))
    quarter = len(errors_m) // 4
    return bool(errors_m[-quarter:].max() > errors_m[-2 * quarter : -quarter].max())


def test_delay_margin_without_lag_equals_that_of_the_modes() -> None:
    margin_s = delay_margin_with_lag_s(chained(1, average_26(K)), IDEAL)
    assert margin_s == pytest.approx(mode_figures(K, 1.0).delay_margin_s, rel=5e-3)


def test_delay_margin_is_zero_above_the_lag_margin() -> None:
    assert delay_margin_with_lag_s(chained(4, weighted(K)), LinearModel(attitude_lag_s=0.87)) == 0.0
    assert delay_margin_with_lag_s(chained(4, FED_FORWARD), LinearModel(attitude_lag_s=5.0)) == 0.0


def test_delay_margin_is_zero_without_a_leader() -> None:
    assert delay_margin_with_lag_s(couple(chain(3), set(), weighted(K)), LinearModel()) == 0.0
    assert delay_margin_with_lag_s(couple({1: [], 2: []}, {1}, cooperative()), LinearModel()) == 0.0


# ---------------------------------------------------------------- transient peak


@pytest.mark.parametrize("law", [weighted(), FED_FORWARD, COOPERATIVE])
def test_worst_start_bounds_all_unit_starts(law: NeighbourFeedback) -> None:
    coupling = chained(8, law)
    each_alone = errors_over_time(
        coupling, np.eye(8), LinearModel(), 60.0
    )  # one axis for every vehicle that starts off
    assert worst_transient_peak(coupling, LinearModel()) == pytest.approx(
        np.abs(each_alone).sum(axis=2).max(), rel=0.02
    )


@pytest.mark.parametrize(
    ("n", "law"),
    [
        (3, weighted(Gains(10.0, 1.0))),
        (2, weighted(Gains(1.39, 0.36))),  # unstable by a hair, and by the delay alone: its figures looked like figures
        (2, weighted(Gains(3.0, 0.5))),  # even without delay
        (3, law_of(Gains(10.0, 1.0), 8.0, True, 0.9)),
    ],
)
def test_unstable_formation_has_no_string_gain(n: int, law: NeighbourFeedback) -> None:
    coupling = chained(n, law)
    assert not is_stable(coupling, LinearModel())
    assert string_gains(coupling, LinearModel()) is None


def test_worst_start_of_a_stable_chain_can_be_large() -> None:
    peak = worst_transient_peak(chained(60, weighted(PAPER_GAINS, 16.0)), LinearModel())
    assert 1e6 < peak < np.inf


def test_critically_damped_vehicle_has_no_overshoot() -> None:
    assert worst_transient_peak(chained(1, weighted(Gains(1.0, 2.0))), IDEAL) == pytest.approx(1.0, abs=1e-3)


# ---------------------------------------------------------------- companion analyze


def changed(tmp_path: Path, **changes: object) -> Path:
    data = yaml.safe_load((SCENARIOS / "platoon.yaml").read_text())
    data["fleet"].update(changes)
    ids = {vehicle["id"] for vehicle in data["fleet"]["vehicles"]}
    data["starts_enu_m"] = {i: start for i, start in data["starts_enu_m"].items() if i in ids}
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(data))
    return tmp_path / "scenario.yaml"


def members(n: int, leaders: int = 1) -> list[dict[str, object]]:
    return [
        {"id": i, "role": "leader" if i <= leaders else "follower", "slot_enu_m": [-1.5 * (i - 1), 0.0, 0.0]}
        for i in range(1, n + 1)
    ]


def test_analyze_compares_all_four_laws(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["analyze", str(SCENARIOS / "platoon.yaml"), "--json"]) == 0
    laws = json.loads(capsys.readouterr().out)["laws"]
    assert list(laws) == ["cooperative", "weighted", "average_22", "average_26"]
    for law in laws.values():
        assert law["string_gain_to_last"] >= law["string_gain_per_hop"] >= 1.0
        assert 0.15 < law["delay_margin_with_lag_s"] < law["delay_margin_s"] + 0.01
        assert law["worst_transient_peak"] >= 1.0
        assert law["transient_peak"] <= 1.02 * law["worst_transient_peak"]
    assert laws["cooperative"]["string_gain_to_last"] < 0.5 * laws["weighted"]["string_gain_to_last"]
    assert laws["cooperative"]["rate_1_s"] > 3.0 * laws["weighted"]["rate_1_s"]


def test_growing_errors_are_reported_with_remedies(tmp_path: Path) -> None:
    law = {
        "name": "cooperative",
        "parameters": {"position_gain_1_s2": 1.0, "velocity_gain_1_s": 2.5, "feedforward": 0.9, "exponent": 8},
    }
    grows_under_weighted = verdict(analyse(load_subject(changed(tmp_path, law={"name": "weighted"}))))
    assert any(f.code is Code.ERRORS_GROW and "feedforward" in f.text for f in grows_under_weighted)
    (finding,) = verdict(analyse(load_subject(changed(tmp_path, law=law))))
    assert finding.code is Code.FORMATION_CONVERGES


@pytest.mark.parametrize(
    ("gains", "said", "code"),
    [
        ({"position_gain_1_s2": 3.0, "velocity_gain_1_s": 1.2}, "small delay margin", 0),
        ({"position_gain_1_s2": 10.0, "velocity_gain_1_s": 1.0}, "unstable with the attitude lag alone", 1),
        ({"position_gain_1_s2": 10.0, "velocity_gain_1_s": 10.0}, "unstable with the attitude lag alone", 1),
        ({"position_gain_1_s2": 1e-9, "velocity_gain_1_s": 10.0}, "unstable with the attitude lag alone", 1),
        ({"position_gain_1_s2": 2.2, "velocity_gain_1_s": 2.6}, "unstable with the delays of its flight", 1),
        ({"position_gain_1_s2": 1e-9, "velocity_gain_1_s": 1.0}, "not within 10 cm", 0),
        ({"position_gain_1_s2": 10.0, "velocity_gain_1_s": 1e-9}, "unstable with the attitude lag alone", 1),
    ],
)
def test_bad_gains_are_reported(
    tmp_path: Path, gains: object, said: str, code: int, capsys: pytest.CaptureFixture[str]
) -> None:
    path = changed(tmp_path, law={"name": "weighted", "parameters": gains})
    assert main(["analyze", str(path)]) == code
    text = capsys.readouterr().out
    assert said in " ".join(text.split())
    assert "nan" not in text
    assert main(["analyze", str(path), "--json"]) == code
    json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("law", ["cooperative", "weighted", "average_22", "average_26"])
def test_single_vehicle_is_reported(tmp_path: Path, law: str, capsys: pytest.CaptureFixture[str]) -> None:
    for neighbours in ({"kind": "edges", "edges": []}, {"kind": "range", "range_m": 3.0}):
        path = changed(tmp_path, vehicles=members(1), neighbours=neighbours, law={"name": law})
        assert main(["analyze", str(path), "--json"]) == 0
        figures = json.loads(capsys.readouterr().out)
        assert [finding["code"] for finding in figures["verdict"]] == [Code.SINGLE_VEHICLE]
        assert figures["laws"][law]["string_gain_per_hop"] is None
        assert figures["laws"][law]["margin_to_range_m"] is None
        assert "nan" not in report(analyse(load_subject(path)))


def test_leaders_without_neighbours_are_analyzed(tmp_path: Path) -> None:
    path = changed(tmp_path, vehicles=members(4, leaders=4), neighbours={"kind": "edges", "edges": []})
    analysis = analyse(load_subject(path))
    assert analysis.laws["cooperative"].string_gain_to_last is None
    assert "nan" not in report(analysis)


def test_zero_start_errors_are_analyzed(tmp_path: Path) -> None:
    data = yaml.safe_load((SCENARIOS / "platoon.yaml").read_text())
    x, y, z = data["reference"]["point_enu_m"]
    height_m = data["fleet"].get("takeoff_height_m", 2.5)
    for member in data["fleet"]["vehicles"]:
        dx, dy, dz = member["slot_enu_m"]
        data["starts_enu_m"][member["id"]] = [x + dx, y + dy, z + dz - height_m]
    (tmp_path / "scenario.yaml").write_text(yaml.safe_dump(data))
    law = analyse(load_subject(tmp_path / "scenario.yaml")).laws["weighted"]
    assert (law.transient_peak, law.time_to_10_cm_s, law.predicted_settle_s) == (1.0, 0.0, 0.0)


def test_the_graph_is_judged_before_the_reference(capsys: pytest.CaptureFixture[str]) -> None:
    """A missing edge is no reference that cannot be followed."""
    assert (
        main(["analyze", str(SCENARIOS / "ring_figure_8.yaml"), "--set", "fleet.neighbours.edges=[[1, 2], [3, 4]]"])
        == 1
    )
    assert "NO_PATH_TO_LEADER: cannot converge: no path leads from a leader to vehicle 3, 4" in capsys.readouterr().out


def test_a_reference_of_vehicles_without_a_path_is_refused_for_that() -> None:
    content = yaml.safe_load((SCENARIOS / "ring_figure_8.yaml").read_text(encoding="utf-8"))
    content["fleet"]["neighbours"]["edges"] = [[1, 2], [3, 4]]
    fleet = convert(Path("fleet.yaml"), content["fleet"], FleetConfig)
    (problem,) = flyable_problems(fleet, convert(Path("fleet.yaml"), content["reference"], Reference))
    assert problem.field == "fleet.neighbours"
    assert problem.text.startswith("no path leads from a leader to vehicle 3, 4; add an edge")


@pytest.mark.parametrize(
    "changes",
    [
        {"neighbours": {"kind": "edges", "edges": [[1, 2], [3, 4]]}},
        {"neighbours": {"kind": "edges", "edges": []}},
        {"neighbours": {"kind": "range", "range_m": 0.5}},
    ],
)
def test_json_has_the_reason_for_no_convergence(
    tmp_path: Path, changes: dict[str, object], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", str(changed(tmp_path, **changes)), "--json"]) == 1
    figures = json.loads(capsys.readouterr().out)
    assert figures["laws"] == {}
    assert len(figures["verdict"]) == 1
    assert figures["verdict"][0]["code"] == Code.NO_PATH_TO_LEADER


@pytest.mark.parametrize(
    "law",
    [
        {"parameters": {"exponent": 17}},
        {"parameters": {"exponent": -1}},
        {"parameters": {"feedforward": 1.0}},
        {"parameters": {"feedforward": -0.1}},
        {"parameters": {"position_gain_1_s2": 0, "velocity_gain_1_s": 1}},
        {"parameters": {"position_gain_1_s2": 1, "velocity_gain_1_s": 11}},
        {"parameters": {"position_gain_1_s2": float("nan"), "velocity_gain_1_s": 1}},
        {"name": "average_22", "parameters": {"feedforward": 0.5}},
        {"name": "best"},
    ],
)
def test_law_out_of_bounds_is_reported_in_one_line(
    tmp_path: Path, law: object, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["analyze", str(changed(tmp_path, law=law))]) == 2
    error = capsys.readouterr().err
    assert "law" in error
    assert error.count("\n") == 1


def test_margin_to_the_range_is_consistent(tmp_path: Path) -> None:
    path = changed(tmp_path, neighbours={"kind": "range", "range_m": 1.7, "hysteresis_m": 0.1})
    law = analyse(load_subject(path)).laws["weighted"]
    assert law.margin_to_range_m == pytest.approx(1.8 - max(law.predicted_max_distance_m.values()), abs=1e-4)
    assert law.stays_in_range is (law.margin_to_range_m >= 0.0)
