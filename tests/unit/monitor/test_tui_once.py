"""`companion monitor --once --json`: the array on standard output, and what it cannot have on standard error."""

from __future__ import annotations

import json

import pytest

from companion.monitor.tui import json_once
from ground_fleet import leader, reported, rows_of


def test_a_vehicle_that_never_reported_is_named_beside_the_array(capsys: pytest.CaptureFixture[str]) -> None:
    json_once(rows_of(leader(), reported(2)), {"platoon": frozenset({1, 2, 4})})
    shown = capsys.readouterr()
    assert [row["vehicle_id"] for row in json.loads(shown.out)] == [1, 2]
    assert shown.err == "companion monitor: fleet platoon: NEVER HEARD: vehicle 4 of its fleet file\n"


def test_a_whole_fleet_has_the_array_alone(capsys: pytest.CaptureFixture[str]) -> None:
    json_once(rows_of(leader(), reported(2)), {"platoon": frozenset({1, 2})})
    assert capsys.readouterr().err == ""
