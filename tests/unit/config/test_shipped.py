"""Shipped scenarios: found by their names from any folder, listed, and the answer to a wrong name."""

import sys
from pathlib import Path

import pytest

from common import ROOT
from companion.cli.main import main as companion_main
from companion.config.file import ConfigError
from companion.config.shipped import scenario_file, shipped_lines, shipped_names
from sitl.cli.main import main
from sitl.flight.scenario import load_scenario

FILES = sorted((ROOT / "config" / "scenarios").glob("*.yaml"))


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


def ended(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> object:
    monkeypatch.setattr(sys, "argv", ["sitl", *arguments])
    with pytest.raises(SystemExit) as caught:
        main()
    return caught.value.code


def test_each_is_found_by_its_name() -> None:
    assert shipped_names() == [file.stem for file in FILES]
    for file in FILES:
        assert scenario_file(Path(file.stem)).resolve() == file
    assert load_scenario(Path("platoon"), ["fleet.law.name=average_22"]).fleet.law.name == "average_22"


def test_a_path_is_a_path(elsewhere: Path) -> None:
    for given in ("platoon.yaml", "./platoon.yaml", "folder/platoon", "/platoon"):
        assert scenario_file(Path(given)) == Path(given)
    (elsewhere / "ring_figure_8").mkdir()  # a folder of results hides no scenario
    assert scenario_file(Path("ring_figure_8")).name == "ring_figure_8.yaml"
    (elsewhere / "platoon").write_text("", encoding="utf-8")
    assert scenario_file(Path("platoon")) == Path("platoon")


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("platon", "did you mean platoon or lab_platoon or platoon_wind? "),
        ("ring_figure8", "did you mean ring_figure_8? "),
        ("xyz", ""),
    ],
)
def test_a_wrong_name_is_one_line_with_near_ones(name: str, hint: str) -> None:
    with pytest.raises(ConfigError) as caught:
        scenario_file(Path(name))
    line = f"no such file, and no shipped scenario of this name; {hint}`sitl scenarios` lists them"
    assert str(caught.value) == f"{name}: {line}"


@pytest.mark.parametrize("command", ["run", "fly", "fleet", "compare"])
def test_every_command_that_takes_a_scenario_takes_a_name(
    command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert ended(monkeypatch, command, "platon") == 2
    error = capsys.readouterr().err
    assert "did you mean platoon" in error and error.count("\n") == 1
    # of a scenario that is found, the key is refused
    assert ended(monkeypatch, command, "platoon", "--set", "fleet.law.name=none") == 2
    assert "--set: fleet.law.name: 'none'" in capsys.readouterr().err


def test_the_list_has_a_line_for_each(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    assert ended(monkeypatch, "scenarios") == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines == list(shipped_lines())
    assert [line.split()[0] for line in lines] == shipped_names()
    for line, name in zip(lines, shipped_names(), strict=True):
        scenario = load_scenario(Path(name))
        assert line.split()[1:4] == [str(len(scenario.fleet.vehicles)), "vehicles", scenario.fleet.law.name]
        sentence = line.split(maxsplit=4)[4]
        assert scenario.description.startswith(sentence) and sentence.endswith(".")


def test_analyze_knows_them_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert companion_main(["analyze", "plato"]) == 2
    assert "did you mean platoon or lab_platoon?" in capsys.readouterr().err
