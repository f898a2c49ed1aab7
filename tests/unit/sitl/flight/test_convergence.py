"""Formations that cannot converge are refused before they fly."""

from pathlib import Path

import pytest

from common import ROOT
from companion.config.file import ConfigError
from companion.tools.analysis import analyse
from companion.tools.subject import load_subject
from companion.types.notices import Code
from sitl.cli.main import main as sitl
from sitl.flight.flights import DivergesError, check_convergence
from sitl.flight.scenario import load_scenario

SCENARIOS = ROOT / "config" / "scenarios"
PLATOON, CHAIN = SCENARIOS / "platoon.yaml", SCENARIOS / "chain_16.yaml"


# Laws without feed-forward follow these references too late for separation_m: vehicles and sitl refuse them.
TOO_FAST = {
    "weighted": {"leaving", "moving_target"},
    "average_22": {"formations", "leaving", "moving_target", "turning_column"},
    "average_26": {"formations", "leaving", "moving_target", "turning_column"},
    "cooperative": set(),
}


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.yaml")), ids=lambda path: path.stem)
@pytest.mark.parametrize("law", sorted(TOO_FAST))
def test_every_shipped_scenario_converges_under_every_law_that_can_follow_it(path: Path, law: str) -> None:
    overrides = [f"fleet.law.name={law}"]
    if path.stem in TOO_FAST[law]:
        with pytest.raises(
            ConfigError, match=r"would come within .* m of each other, separation_m is .*; expected at (most|least)"
        ):
            load_scenario(path, overrides)
    else:
        check_convergence(load_scenario(path, overrides))


@pytest.mark.parametrize(
    ("path", "override", "code"),
    [
        (PLATOON, "fleet.law.parameters.velocity_gain_1_s=0.05", Code.FORMATION_UNSTABLE),
        (CHAIN, "fleet.neighbours.edges=[[1,2]]", Code.NO_PATH_TO_LEADER),
    ],
)
def test_a_formation_that_cannot_converge_is_refused(path: Path, override: str, code: Code) -> None:
    with pytest.raises(DivergesError, match=f"^{code}: "):
        check_convergence(load_scenario(path, [override]))


def test_the_warnings_are_those_of_analyze() -> None:
    codes = {notice.code for notice in check_convergence(load_scenario(PLATOON))}
    assert codes == {Code.BADLY_DAMPED, Code.ERRORS_GROW}
    assert check_convergence(load_scenario(SCENARIOS / "four_in_line.yaml")) == []


def test_a_small_delay_margin_is_told_beside_the_delay_of_this_flight() -> None:
    found = check_convergence(load_scenario(PLATOON, ["fleet.law.parameters.velocity_gain_1_s=0.4"]))
    texts = [notice.text for notice in found if notice.code is Code.SMALL_DELAY_MARGIN]
    assert texts == ["unstable from a loop delay of 0.071 s on; this flight has 0.041 s"]


@pytest.mark.parametrize("velocity_1_s", [0.05, 0.2, 1.0])
def test_the_criterion_is_that_of_analyze(velocity_1_s: float, tmp_path: Path) -> None:
    scenario = load_scenario(PLATOON, [f"fleet.law.parameters.velocity_gain_1_s={velocity_1_s}"])
    file = tmp_path / "scenario.yaml"
    text = PLATOON.read_text(encoding="utf-8")
    text = text.replace("name: weighted ", f"parameters: {{velocity_gain_1_s: {velocity_1_s}}}\n    name: weighted ")
    file.write_text(text, encoding="utf-8")
    assert load_scenario(file).fleet.law == scenario.fleet.law
    try:
        check_convergence(scenario)
        converges = True
    except DivergesError:
        converges = False
    assert analyse(load_subject(file)).converges == converges


def test_run_refuses_an_unstable_formation_unless_anyway_is_given(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [
        "sitl",
        "run",
        str(PLATOON),
        "--set",
        "fleet.law.parameters.velocity_gain_1_s=0.05",
        "--out",
        str(tmp_path / "x"),
    ]
    monkeypatch.setattr("sys.argv", arguments)
    with pytest.raises(SystemExit, match="2"):
        sitl()
    assert capsys.readouterr().err.startswith("FORMATION_UNSTABLE: ")
    assert not (tmp_path / "x").exists()
    monkeypatch.setattr("sys.argv", [*arguments, "--anyway", "--quiet", "--set", "timeline[3].for_s=1"])
    with pytest.raises(SystemExit, match=r"0|1"):
        sitl()
    assert capsys.readouterr().err.startswith("warning, weighted: FORMATION_UNSTABLE: ")
    assert (tmp_path / "x" / "summary.json").exists()


def test_what_is_to_be_expected_of_a_law_is_no_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        "sys.argv", ["sitl", "run", str(PLATOON), "--set", "timeline[3].for_s=1", "--out", str(tmp_path / "x")]
    )
    with pytest.raises(SystemExit, match="0"):
        sitl()
    assert capsys.readouterr().out.splitlines()[:3] == [
        "expected of weighted: swings before it settles, damping 0.22 of 1 (BADLY_DAMPED)",
        "expected of weighted: swings grow up to 3.91 times to the rear (ERRORS_GROW)",
        "changed: timeline[3].for_s=1",
    ]
