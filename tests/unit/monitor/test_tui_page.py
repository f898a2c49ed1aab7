"""The picture in a terminal: its text at three widths, and what is shown where not all of it fits."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from companion.monitor.api import Snapshot
from companion.monitor.tui_page import TURN_S, fit_page, page
from companion.types.flight import HealthFlag, Role
from companion.types.notices import Code, Notice
from companion.types.status import NetworkState
from ground_fleet import large_fleet, leader, reported, snapshot_of, troubled_fleet
from tests.bench.monitor_load import steady_fleet

SNAPSHOTS = Path(__file__).parent / "snapshots"


def texts(vehicles: Snapshot, width: int) -> list[str]:
    return [line.text for line in page(vehicles, width)]


@pytest.mark.parametrize("width", [80, 120, 200])
def test_the_whole_picture(width: int) -> None:
    """The files were read by people: change them together with what they show."""
    assert "\n".join(texts(troubled_fleet(), width)) + "\n" == (SNAPSHOTS / f"{width}.txt").read_text()


@given(st.integers(40, 260), st.integers(1, 80), st.floats(0.0, 1e6))
def test_no_line_is_wider_than_the_terminal_and_no_picture_higher(width: int, height: int, now_s: float) -> None:
    for vehicles in (troubled_fleet(), large_fleet()):
        lines = fit_page(vehicles, width, height, now_s)
        assert len(lines) <= height
        assert max(len(line.text) for line in lines) <= width


def test_where_all_of_it_fits_nothing_is_left_out() -> None:
    vehicles = troubled_fleet()
    assert fit_page(vehicles, 80, len(page(vehicles, 80)), 0.0) == page(vehicles, 80)


def ids_shown(height: int, now_s: float) -> list[int]:
    lines = (line.text for line in fit_page(large_fleet(), 80, height, now_s))
    return [int(text[:3]) for text in lines if text[:3].strip().isdigit()]


def test_on_a_low_terminal_vehicles_with_problems_come_first_and_the_others_take_turns() -> None:
    turns = [ids_shown(24, turn * TURN_S) for turn in range(10)]
    assert all(shown[:2] == [17, 33] for shown in turns)
    assert {i for shown in turns for i in shown} == set(range(1, 51))


def test_vehicles_with_problems_that_do_not_fit_are_named() -> None:
    vehicles = snapshot_of(leader(), *(reported(i, flags=(HealthFlag.TICK_LATE,)) for i in range(2, 14)))
    lines = [line.text for line in fit_page(vehicles, 80, 12, 0.0)]
    assert any("more, with flags: vehicles" in text and "13" in text for text in lines)


def test_a_problem_of_many_vehicles_has_one_note() -> None:
    vehicles = snapshot_of(leader(), *(reported(i, flags=(HealthFlag.LEADER_LOST,)) for i in (2, 3, 4)))
    assert [text for text in texts(vehicles, 80) if "LEADER_LOST, " in text] == [
        "  LEADER_LOST, vehicles 2, 3, 4: no fresh leader beacon"
    ]


def test_an_old_value_of_a_silent_vehicle_is_not_in_its_row() -> None:
    row = next(text for text in texts(troubled_fleet(), 200) if text.startswith("  3 "))
    assert "SILENT" in row
    for old in ("OFFBOARD", "87%", "50.0", "-3.0 0.0 2.5"):
        assert old not in row


def test_a_silent_leader_does_not_lead_and_a_silent_position_has_no_distance() -> None:
    (first, *_), *_ = [texts(snapshot_of(leader(), reported(2), silent=(1,)), 120)]
    assert first == "fleet platoon: 2 vehicles, SILENT: vehicle 1, NO LEADER, operator anna@ground"


def test_a_vehicle_of_the_fleet_file_that_never_reported_is_in_the_heading() -> None:
    expected = {name: steady_fleet(name, 3).fleet for name in ("platoon", "other")}
    snapshot = snapshot_of(leader(), reported(2), fleets=expected)
    for lines in (page(snapshot, 120), fit_page(snapshot, 120, 4, 0.0)):
        assert "NEVER HEARD: vehicle 3" in lines[0].text
    assert "NEVER HEARD" not in page(snapshot_of(leader(), reported(2)), 120)[0].text


def test_a_fleet_that_strangers_can_command_is_named_in_its_heading() -> None:
    lines = texts(snapshot_of(leader(), reported(4, network=NetworkState("none"))), 120)
    assert any("UNSECURED (strangers can command): vehicle 4" in text for text in lines[:2])


def test_each_fleet_has_a_table_and_a_heading() -> None:
    vehicles = snapshot_of(leader(fleet="alpha"), leader(), reported(2))
    headings = [text.partition(",")[0] for text in texts(vehicles, 80) if text.startswith("fleet ")]
    assert headings == ["fleet alpha: 1 vehicle", "fleet platoon: 2 vehicles"]


def test_no_event_controls_the_terminal() -> None:
    hostile = snapshot_of(leader(last_event=Notice(Code.PROCEDURE_FAILED, "\x1b[2J\x07arm: no\nroot\u202e")))
    for width in (80, 200):
        assert any("PROCEDURE_FAILED: ?[2J?arm: no?root?" in text for text in texts(hostile, width))


def test_the_leader_is_named() -> None:
    vehicles = snapshot_of(reported(1), reported(2, role=Role.LEADER, prc=1))
    assert "leader 2" in texts(vehicles, 120)[0]
