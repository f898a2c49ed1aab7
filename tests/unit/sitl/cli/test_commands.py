"""Command lines: missing packages, Ctrl-C during the start, invalid arguments."""

import subprocess
import sys
from typing import NoReturn

import pytest

from companion import GROUND_INSTALL
from companion.cli import main as cli
from sitl.cli.main import main as sitl

WITHOUT = (
    "import sys; sys.modules[{package!r}] = None; from sitl.cli.main import main; "
    "sys.argv = ['sitl', {command!r}]; main()"
)


def interrupted(*_: object, **__: object) -> NoReturn:
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("command", "package"),
    [("compare", "scipy"), ("paper", "jinja2"), ("compare", "matplotlib"), ("gauntlet", "rich")],
)
def test_a_missing_package_is_reported_in_one_line(command: str, package: str) -> None:
    code = WITHOUT.format(package=package, command=command)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    wanted = f"sitl {command}: {package} is not installed; {GROUND_INSTALL}\n"
    assert (done.returncode, done.stderr) == (2, wanted)


@pytest.mark.parametrize(
    ("run", "arguments"),
    [
        ("companion.app.run_agent", ["agent", "--config", "vehicle.yaml"]),
        ("companion.monitor.tui.run_monitor", ["monitor", "--tui"]),
        ("companion.monitor.live_page.run_live_page", ["monitor"]),
    ],
)
def test_agent_and_monitor_exit_with_0_on_ctrl_c_during_the_start(
    run: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run, interrupted)
    assert cli.main(arguments) == 0


@pytest.mark.parametrize(
    ("run", "arguments"),
    [
        ("companion.tools.subject.load_subject", ["analyze", "fleet.yaml"]),
        ("companion.tools.doctor.run_doctor", ["doctor", "--config", "vehicle.yaml"]),
    ],
)
def test_a_command_with_a_result_prints_interrupted_on_ctrl_c(
    run: str, arguments: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(run, interrupted)
    with pytest.raises(SystemExit, match="130"):
        cli.main(arguments)
    assert capsys.readouterr().err == "interrupted\n"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["compare", "x.yaml", "--seeds", "1.5"], "'1.5', expected a whole number from 1 to"),
        (["fly", "x.yaml", "--port-offset", "1.5"], "'1.5', expected a whole number from 0 to"),
    ],
)
def test_a_number_that_is_not_whole_is_refused(
    arguments: list[str], words: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["sitl", *arguments])
    with pytest.raises(SystemExit, match="2"):
        sitl()
    assert words in capsys.readouterr().err


def test_a_wait_of_0_s_is_refused_with_its_limits(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit, match="2"):
        cli.main(["agent", "--config", "x.yaml", "--wait-s", "0"])
    assert "expected seconds above 0, up to 3600" in capsys.readouterr().err


def test_sitl_prints_its_name_and_version(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["sitl", "--version"])
    with pytest.raises(SystemExit):
        sitl()
    assert capsys.readouterr().out == "sitl 0.1.0\n"
