"""Completion scripts for shells: what bash offers for a line."""

import subprocess
import sys
from pathlib import Path

import pytest

from companion.cli.main import main

OFFERED = """\
source {script}
COMP_WORDS=({line} ""); COMP_CWORD=$((${{#COMP_WORDS[@]}} - 1))
_shtab_{program} {program}
printf '%s\\n' "${{COMPREPLY[@]}}"
"""


@pytest.fixture(scope="module")
def scripts(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("completion")
    files = {program: folder / f"{program}.bash" for program in ("companion", "sitl")}
    for program, file in files.items():
        command = [sys.executable, "-m", program, "completion", "bash"]
        file.write_text(subprocess.run(command, capture_output=True, text=True, check=True).stdout, encoding="utf-8")
    return files


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("companion", {"agent", "doctor", "fleet", "monitor", "completion"}),
        ("companion fleet", {"status", "arm", "takeoff", "formation"}),
        ("companion fleet formation", {"v", "diamond"}),
        ("sitl", {"run", "fly", "fleet", "completion"}),
    ],
)
def test_bash_offers_commands_and_choices(line: str, offered: set[str], scripts: dict[str, Path]) -> None:
    program = line.split()[0]
    script = OFFERED.format(script=scripts[program], line=line, program=program)
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=30, check=True)
    assert offered <= set(done.stdout.split())


def test_a_script_for_zsh_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "zsh"]) == 0
    assert capsys.readouterr().out.startswith("#compdef companion\n")


def test_completion_without_its_package_names_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "shtab", None)
    assert main(["completion", "bash"]) == 2
    assert "shtab is not installed; " in capsys.readouterr().err
