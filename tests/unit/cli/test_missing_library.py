"""A library that is missing or broken is one line, with advice that fits the installation."""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

import pytest

import companion
from companion import how_to_install
from companion.cli.program import Program, command
from companion.types.errors import UnusableError


@pytest.mark.parametrize("words", [["fleet", "status"], ["monitor", "--fleet", "ring"]])
def test_zenoh_that_is_missing_is_one_line(words: list[str]) -> None:
    """In a process of its own: here other tests have imported what needs it."""
    code = "import sys; sys.modules['zenoh'] = None; from companion.cli.main import main; sys.exit(main(sys.argv[1:]))"
    ended = subprocess.run(
        [sys.executable, "-c", code, *words], capture_output=True, text=True, timeout=60.0, check=False
    )
    assert ended.returncode == 2
    (line,) = ended.stderr.splitlines()
    assert line.startswith(f"companion {words[0]}: zenoh is not installed; ")


def ended_by(error: ImportError) -> str:
    def run(_: argparse.Namespace) -> int:
        """Raise it."""
        raise error

    program = Program("companion", "", (command("agent", "", lambda _: None, run),), ending=lambda _, run: run())
    with pytest.raises(UnusableError) as caught:
        program.main(["agent"])
    return str(caught.value)


def test_a_library_that_cannot_be_loaded_says_why() -> None:
    error = ImportError("libz.so.1: cannot open shared object file", name="zenoh.zenoh")
    assert ended_by(error).startswith(
        "companion agent: zenoh cannot be used: libz.so.1: cannot open shared object file; "
    )


@pytest.mark.parametrize("name", ["companion.core.agent", "tomllib", None])
def test_a_defect_of_the_program_itself_stays_a_traceback(name: str | None) -> None:
    with pytest.raises(ImportError):
        ended_by(ImportError("cannot import name 'x'", name=name))


def test_the_advice_fits_the_installation(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "companion").mkdir()
    monkeypatch.setattr(companion, "__file__", str(tmp_path / "companion" / "__init__.py"))
    assert how_to_install("ground").startswith("this installation is without the extra [ground]; ")
    (tmp_path / "pyproject.toml").write_text("")
    assert how_to_install("ground").endswith(f" -m pip install '{tmp_path}[ground]'")
