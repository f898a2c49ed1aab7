"""How `sitl fleet` tells an operator to call `companion`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from sitl.flight.processes.waiting_fleet import companion_program


def test_companion_in_the_path_is_called_by_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "companion").write_text("#!/bin/sh\n", encoding="utf-8")
    (tmp_path / "companion").chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert companion_program() == "companion"


def test_else_it_is_called_by_its_path_from_here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.setattr(sys, "executable", str(tmp_path / ".venv/bin/python"))
    monkeypatch.chdir(tmp_path)
    assert companion_program() == ".venv/bin/companion"
    monkeypatch.chdir("/")
    assert companion_program().endswith("/.venv/bin/companion")
