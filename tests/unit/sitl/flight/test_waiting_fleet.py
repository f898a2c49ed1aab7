"""How `sitl fleet` tells an operator to call `companion`, and which vehicles it could not land."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from sitl.flight.files import truth_path
from sitl.flight.fly import companion_program, landed_in_words, left_armed
from sitl.vehicle.truth import TRUTH_HEADER


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


ROW = "{:.6f},0.0,0.0,{:.5f},0.0,0.0,0.0,0.0,0.0,0.0,0.5,{},LOITER\n"


def test_a_vehicle_that_nobody_could_land_is_named(tmp_path: Path) -> None:
    rows = {
        1: [(1.0, 2.0, 1), (2.0, 0.0, 0)],  # landed by its autopilot
        3: [(n / 50.0, 2.0, 1) for n in range(100)],
        4: [],
    }
    for i, of_vehicle in rows.items():
        text = TRUTH_HEADER + "".join(ROW.format(*row) for row in of_vehicle)
        truth_path(tmp_path, i).write_text(text + "2.5,0.0", encoding="utf-8")  # an incomplete last row is left out
    assert left_armed(tmp_path, {1, 3, 4}) == ["vehicle 3 was left armed at 2.0 m: its agent or stand-in had ended"]


def test_all_have_landed_only_where_no_agent_or_stand_in_has_ended() -> None:
    assert landed_in_words([1, 2, 3], set()) == "all landed"
    assert landed_in_words([1, 2, 3], {2}) == "vehicles 1, 3 landed, an agent or a stand-in of vehicle 2 had ended"
    assert landed_in_words([1, 2], {1, 2}) == "an agent or a stand-in of vehicles 1, 2 had ended"
