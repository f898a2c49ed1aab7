"""Findings of `companion analyze` for formations at the limit of stability; its advice must help."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from common import ROOT
from companion.analysis.interaction import couple
from companion.analysis.margins import least_delay_margin_s, string_gains
from companion.analysis.response import SPARE_S, flown_model
from companion.cli.main import main
from companion.config.file import ConfigError
from companion.config.named_files import law_override
from companion.tools.analysis import Analysis, analyse
from companion.tools.analysis_report import report, verdict
from companion.tools.subject import load_subject
from companion.types.formation import Gains
from companion.types.notices import Code
from sitl.flight.scenario import ScenarioFile, load_scenario
from tests.helpers.laws import law_of

CONFIG = ROOT / "config"
MODELS = [flown_model(link_s=link_s) for link_s in (0.001, 0.05, 0.1)]
LEAST_S = MODELS[0].delay_s + SPARE_S
NO_FIGURES = (
    "string_gain_per_hop",
    "string_gain_per_hop_rad_s",
    "string_gain_to_last",
    "string_gain_to_last_rad_s",
    "transient_peak",
    "worst_transient_peak",
    "time_to_10_cm_s",
    "predicted_settle_s",
    "leader_settle_s",
    "leader_step_settle_s",
    "predicted_max_distance_m",
    "predicted_min_distance_m",
    "stays_in_range",
    "margin_to_range_m",
)


def in_a_line(tmp_path: Path, n: int, law: dict[str, Any], **changes: Any) -> Path:
    data = yaml.safe_load((CONFIG / "fleets" / "pair.yaml").read_text())
    data["vehicles"] = [
        {"id": i, "role": "leader" if i == 1 else "follower", "slot_enu_m": [1.5 - 1.5 * i, 0.0, 0.0]}
        for i in range(1, n + 1)
    ]
    data["neighbours"] = {"kind": "edges", "edges": [[i, i + 1] for i in range(1, n)]}
    data["law"] = law
    data.update(changes)
    path = tmp_path / "fleet.yaml"
    path.write_text(yaml.safe_dump(data))
    return path


def law(k1: float, k2: float, **more: Any) -> dict[str, Any]:
    return {"name": "weighted", "parameters": {"position_gain_1_s2": k1, "velocity_gain_1_s": k2, **more}}


# ---------------------------------------------------------------- unstable


@pytest.mark.parametrize(
    ("k1", "k2", "said"),
    [
        (1.39, 0.2, "unstable with the delays of its flight, and so it cannot converge"),
        (3.0, 0.5, "unstable with the attitude lag alone, and so it cannot converge"),
        (2.5, 2.8, "unstable with the delays of its flight, and so it cannot converge"),
        (10.0, 10.0, "unstable with the attitude lag alone, and so it cannot converge"),
    ],
)
@pytest.mark.parametrize("neighbours", ["edges", "range"])
def test_unstable_law_is_reported_without_figures(
    tmp_path: Path, k1: float, k2: float, said: str, neighbours: str, capsys: pytest.CaptureFixture[str]
) -> None:
    changes = {} if neighbours == "edges" else {"neighbours": {"kind": "range", "range_m": 1.6}}
    path = in_a_line(tmp_path, 2, law(k1, k2), **changes)
    assert main(["analyze", str(path), "--json"]) == 1
    figures = json.loads(capsys.readouterr().out)
    weighted = figures["laws"]["weighted"]
    assert figures["converges"] is False
    assert weighted["stable"] is False
    assert [key for key in NO_FIGURES if weighted[key] is not None] == []
    (finding,) = figures["verdict"]
    assert finding["code"] == Code.FORMATION_UNSTABLE
    assert finding["text"].startswith(said)
    others = [name for name, other in figures["laws"].items() if other["delay_margin_with_lag_s"] >= 0.15]
    assert others
    assert f"; {' and '.join(others)} would be stable" in finding["text"]
    assert main(["analyze", str(path)]) == 1
    text = capsys.readouterr().out
    assert said in " ".join(text.split())
    assert "unstable" in next(row for row in text.splitlines() if row.startswith("string gain, leader to last"))


def test_other_law_can_be_unstable(tmp_path: Path) -> None:
    """Delay margin with these gains: 0.17 s with eq. 26, 0.02 s with eq. 22."""
    analysis = analyse(load_subject(in_a_line(tmp_path, 2, law(1.39, 0.2) | {"name": "average_26"})))
    assert [name for name, figures in analysis.laws.items() if not figures.stable] == ["weighted", "average_22"]
    assert analysis.converges
    assert any("cooperative has 1.0" in finding.text for finding in verdict(analysis))


def test_single_vehicle_can_be_unstable(tmp_path: Path) -> None:
    path = in_a_line(tmp_path, 1, law(10.0, 1.0))
    assert main(["analyze", str(path)]) == 1
    (_, finding) = verdict(analyse(load_subject(path)))
    assert finding.code is Code.FORMATION_UNSTABLE
    assert "attitude lag alone" in finding.text


# ---------------------------------------------------------------- advice


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Predictions of only 3 s, because the advice does not depend on them."""
    monkeypatch.setattr("companion.tools.analysis.PREDICT_S", 3.0)


@pytest.fixture
def own_law_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fleet's law without those beside it, on which advice on its gains does not depend."""
    monkeypatch.setattr("companion.tools.analysis.LAW_NAMES", ())
    monkeypatch.setattr("companion.tools.analysis.AVERAGE_LAWS", ())


def advised(tmp_path: Path, n: int, k1: float, k2: float, feedforward: float) -> Analysis:
    return analyse(load_subject(in_a_line(tmp_path, n, law(k1, k2, feedforward=feedforward))))


def margin_s(n: int, k1: float, k2: float, feedforward: float) -> float:
    law = law_of(Gains(k1, k2), 1.0, True, feedforward)
    return least_delay_margin_s([couple(chain(n), {1}, law)], MODELS)


def chain(n: int) -> dict[int, list[int]]:
    return {i: [j for j in (i - 1, i + 1) if 1 <= j <= n] for i in range(1, n + 1)}


@pytest.mark.usefixtures("short", "own_law_alone")
@pytest.mark.parametrize("feedforward", [0.0, 0.9])
@pytest.mark.parametrize("k1", [1.39, 3.0, *(pytest.param(k1, marks=pytest.mark.long) for k1 in (0.5, 6.0))])
@pytest.mark.parametrize(
    "ratio_s",
    [0.1, 0.22, 0.36, 1.6, *(pytest.param(ratio_s, marks=pytest.mark.long) for ratio_s in (0.19, 0.26, 0.6, 1.0))],
)
def test_advice_increases_the_delay_margin(tmp_path: Path, k1: float, ratio_s: float, feedforward: float) -> None:
    k2 = round(k1 * ratio_s, 6)
    before_s = margin_s(3, k1, k2, feedforward)
    about_margin = (Code.FORMATION_UNSTABLE, Code.SMALL_DELAY_MARGIN)
    findings = [f for f in verdict(advised(tmp_path, 3, k1, k2, feedforward)) if f.code in about_margin]
    assert len(findings) == (1 if before_s < 0.15 else 0)
    if not findings:
        return
    assert (findings[0].code is Code.FORMATION_UNSTABLE) is (before_s <= LEAST_S)
    if "less gain on both velocity and position helps" in findings[0].text:
        assert any(margin_s(3, 0.9**steps * k1, 0.9**steps * k2, feedforward) > before_s for steps in range(1, 16))
        return
    assert "more gain on velocity or less on position helps" in findings[0].text
    steps_on = range(1, 2 if before_s > 0.0 else 12)  # without a margin, the way to the first one may be longer
    assert any(margin_s(3, k1, 1.1**steps * k2, feedforward) > before_s for steps in steps_on)
    assert any(margin_s(3, 0.9**steps * k1, k2, feedforward) > before_s for steps in steps_on)


@pytest.mark.usefixtures("short", "own_law_alone")
@pytest.mark.parametrize("feedforward", [0.0, 0.9])
@pytest.mark.parametrize(("k1", "ratio_s"), [(0.3, 0.4), (0.3, 1.2), (1.39, 0.7), (1.39, 1.4), (3.0, 0.4), (3.0, 0.6)])
def test_advice_decreases_the_string_gain(tmp_path: Path, k1: float, ratio_s: float, feedforward: float) -> None:
    def to_last(k1: float, k2: float) -> float:
        gains = string_gains(
            couple(chain(4), {1}, law_of(Gains(k1, k2), 1.0, True, feedforward)),
            MODELS[0],
        )
        assert gains is not None
        return gains.to_last

    k2 = round(k1 * ratio_s, 6)
    findings = verdict(advised(tmp_path, 4, k1, k2, feedforward))
    texts = [finding.text for finding in findings if finding.code is Code.ERRORS_GROW]
    assert len(texts) == (to_last(k1, k2) > 1.2)
    for line in texts:
        assert to_last(0.9 * k1, k2) < to_last(k1, k2)
        assert ("more gain on velocity" not in line) or to_last(k1, 1.1 * k2) < to_last(k1, k2)
        assert ("feedforward" in line) is (feedforward == 0.0)


@pytest.mark.usefixtures("short", "own_law_alone")
@pytest.mark.parametrize("ratio_s", [0.22, 0.3, 0.45, 0.7, 1.2])
@pytest.mark.parametrize("k1", [1.39, 3.0, 8.0])
def test_findings_do_not_contradict_each_other(tmp_path: Path, k1: float, ratio_s: float) -> None:
    said = " ".join(map(str, verdict(advised(tmp_path, 4, k1, round(k1 * ratio_s, 6), 0.0))))
    assert not ("more gain on velocity" in said and "less gain on both velocity" in said)


# ---------------------------------------------------------------- for a person


def test_frequency_of_the_largest_gain_is_printed() -> None:
    analysis = analyse(load_subject(CONFIG / "scenarios" / "platoon.yaml"))
    figures = analysis.laws["weighted"]
    assert f"(at {figures.string_gain_per_hop_rad_s:.2f} rad/s)" in " ".join(map(str, verdict(analysis)))
    assert figures.string_gain_to_last_rad_s is not None
    assert 0.2 < figures.string_gain_to_last_rad_s < 2.0


def test_fleet_file_is_analyzed_for_a_step_of_one_metre(tmp_path: Path) -> None:
    """The vehicles have taken off: the height of the reference is not part of the step."""
    analysis = analyse(load_subject(in_a_line(tmp_path, 3, {"name": "cooperative"})))
    assert analysis.start_error_m == pytest.approx(1.0)
    assert "the farthest vehicle 1.00 m from its slot" in " ".join(report(analysis).split())


def test_a_law_with_memory_has_no_shift_by_a_velocity_error() -> None:
    """Integral action takes it out; k2/k1 times the error would be that of the law without it."""
    integral = law_override(str(CONFIG / "examples" / "integral.py"))
    analysis = analyse(load_subject(CONFIG / "scenarios" / "platoon.yaml", [integral]))
    assert analysis.laws["integral"].velocity_error_shift_m is None
    row = next(line for line in report(analysis).splitlines() if line.startswith("shift by"))
    assert row.split()[-5:] == ["0.120", "0.086", "0.086", "0.086", "-"]


def test_moving_reference_is_mentioned() -> None:
    said = "though it moves in flight"
    assert said in " ".join(report(analyse(load_subject(CONFIG / "scenarios" / "ring_figure_8.yaml"))).split())
    assert said not in " ".join(report(analyse(load_subject(CONFIG / "scenarios" / "platoon.yaml"))).split())


# ---------------------------------------------------------------- what it reads of a scenario


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("starts_enu_m:", "starts_enum:", 'starts_enum: unknown key; did you mean "starts_enu_m"?'),
        ("reference:", "refrence:", 'refrence: unknown key; did you mean "reference"?'),
        ("timeline:", "timelin:", 'timelin: unknown key; did you mean "timeline"?'),
        ("stand_in:", "standin:", 'standin: unknown key; did you mean "stand_in"?'),
        ("point_enu_m: [1.0,", "point_enu_m: [500.0,", "vehicle 1 at x = 500 m, outside the fence"),
        ("  4: [", "  5: [", "starts_enu_m.4: missing"),
        ("timeline:", "links: {peer_delay_s: soon}\ntimeline:", "links.peer_delay_s"),
        ("timeline:", "links: 3\ntimeline:", "links: "),
        ("  sensors: ideal", "  autopilot: px5", "stand_in.autopilot"),
        ("    drag_n_per_m_s: 0.0", "    mass_kg: 0", "stand_in.airframe.mass_kg"),
        ("stand_in:\n", "stand_in: 4\ntargets:\n", "stand_in: 4: expected a section"),
    ],
)
def test_invalid_scenario_is_refused_as_in_flight(tmp_path: Path, old: str, new: str, said: str) -> None:
    text = (CONFIG / "scenarios" / "platoon.yaml").read_text(encoding="utf-8")
    assert text.count(old) == 1
    path = tmp_path / "platoon.yaml"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(ConfigError) as caught:
        load_subject(path)
    assert said in str(caught.value)


def test_settings_of_the_command_line_take_the_place_of_those_of_the_file(capsys: pytest.CaptureFixture[str]) -> None:
    platoon = CONFIG / "scenarios" / "platoon.yaml"
    settings = ["fleet.law.name=cooperative", "fleet.law.parameters.weight_ratio=0.2"]
    analysis = analyse(load_subject(platoon, settings))
    assert (analysis.law, analysis.laws["cooperative"].weight_ratio, analysis.settings) == (
        "cooperative",
        0.2,
        settings,
    )
    assert "with fleet.law.name=cooperative, fleet.law.parameters.weight_ratio=0.2" in report(analysis).splitlines()
    assert main(["analyze", str(platoon), "--set", "fleet.law.parameters.weight_ratio=2"]) == 2
    assert capsys.readouterr().err == "--set: fleet.law.parameters.weight_ratio: 2: expected a number <= 1.0\n"


def test_sections_not_read_are_listed() -> None:
    analysis = analyse(load_subject(CONFIG / "scenarios" / "platoon.yaml"))
    assert analysis.not_read == ["stand_in but its autopilot, mass and drag", "timeline"]
    assert "not read and not checked: stand_in but its autopilot, mass and drag, timeline" in report(analysis)


def test_rotation_of_the_formation_is_left_out_with_a_note() -> None:
    analysis = analyse(load_subject(CONFIG / "scenarios" / "turning_column.yaml"))
    assert analysis.not_read == ["timeline", "fleet.formation_heading"]


@pytest.mark.parametrize(
    "path", sorted([*(CONFIG / "scenarios").glob("*.yaml"), *(CONFIG / "fleets").glob("*.yaml")]), ids=lambda p: p.stem
)
def test_every_shipped_scenario_and_fleet_file_is_analyzed(path: Path) -> None:
    assert analyse(load_subject(path)).converges


def test_every_section_of_a_scenario_is_accepted(tmp_path: Path) -> None:
    data = yaml.safe_load((CONFIG / "scenarios" / "platoon.yaml").read_text())
    unused = {"origins_enu_m": {1: [0.0, 0.0, 0.0]}, "assumed": {"hover_thrust_norm": 0.4}, "targets": [], "links": {}}
    unused["agent_ends"] = []
    data |= unused
    path = tmp_path / "scenario.yaml"
    path.write_text(yaml.safe_dump(data))
    load_scenario(path)
    assert set(data) == set(ScenarioFile.__struct_fields__), "the scenario has every section"
    assert {section.split()[0] for section in load_subject(path).not_read} == {"stand_in", "timeline", *unused}


def test_vehicle_file_is_refused() -> None:
    with pytest.raises(ConfigError, match="this is a vehicle file; a scenario or a fleet file is expected"):
        load_subject(next((CONFIG / "vehicles").glob("*.yaml")))


@pytest.mark.usefixtures("own_law_alone")
@pytest.mark.parametrize(("vehicles", "is_deep"), [(16, False), (64, True)])
def test_a_fleet_that_is_too_deep_for_its_delay_is_told(tmp_path: Path, vehicles: int, is_deep: bool) -> None:
    """A motion of the leader reaches the last vehicle a tick per hop later; a leader alone settles in 2.4 s."""
    fence = {"fence_min_enu_m": [-100.0, -30.0, -5.0], "fence_max_enu_m": [30.0, 30.0, 20.0]}
    analysis = analyse(load_subject(in_a_line(tmp_path, vehicles, {"name": "cooperative"}, envelope=fence)))
    found = analysis.laws["cooperative"]
    assert analysis.hops == vehicles - 1
    assert found.leader_settle_s == pytest.approx(2.4, abs=0.3)
    assert (Code.FLEET_TOO_DEEP in [finding.code for finding in verdict(analysis)]) is is_deep


@pytest.mark.parametrize("name", ["exchange", "ring_figure_8"])
def test_a_small_fleet_that_starts_at_its_slots_is_not_too_deep(name: str) -> None:
    """It has settled from the beginning, and so has a leader alone: the comparison is with a step."""
    analysis = analyse(load_subject(CONFIG / "scenarios" / f"{name}.yaml"))
    assert analysis.laws[analysis.law].leader_settle_s == 0.0
    assert Code.FLEET_TOO_DEEP not in [finding.code for finding in verdict(analysis)]


@pytest.mark.usefixtures("short")
def test_report_of_a_large_formation_fits_a_screen(tmp_path: Path) -> None:
    text = report(analyse(load_subject(in_a_line(tmp_path, 24, {"name": "cooperative"}))))
    assert "G and its 24 eigenvalues: see --json" in text
    before_the_verdict = text[: text.index("verdict:")]
    assert max(map(len, before_the_verdict.splitlines())) <= 130
    assert "-0. " not in report(analyse(load_subject(CONFIG / "scenarios" / "chain_16.yaml")))


@pytest.mark.parametrize(("given", "threads"), [(None, "1"), ("2", "2")])
def test_blas_uses_one_thread_unless_configured(given: str | None, threads: str) -> None:
    program = (
        "import os, sys; from companion.cli.main import main; assert 'numpy' not in sys.modules;"
        f"main(['analyze', {str(CONFIG / 'fleets' / 'pair.yaml')!r}, '--json']);"
        "print(os.environ['OMP_NUM_THREADS'], file=sys.stderr)"
    )
    environment = {key: value for key, value in os.environ.items() if not key.endswith("NUM_THREADS")}
    if given:
        environment["OMP_NUM_THREADS"] = given
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert done.stderr.strip() == threads
