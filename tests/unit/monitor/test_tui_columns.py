"""The columns of the terminal's table."""

from __future__ import annotations

from math import inf, nan

import pytest

from companion.cli.main import main
from companion.monitor.tui_page import (
    TableRow,
    cells,
    columns_for,
    count_text,
    duration_text,
    fleets,
    metres_text,
    table_width,
)
from companion.types.code_table import code_table
from companion.types.flight import HealthFlag
from companion.types.status import NearestVehicle, SeparationReport
from ground_fleet import leader, reported, snapshot_of


def row(**changes: object) -> TableRow:
    """Vehicle 2 behind its leader."""
    (fleet,) = fleets(snapshot_of(leader(), reported(2, **changes)))
    return fleet.rows[1]


def cell(of: TableRow, column: str, width: int = 200) -> str:
    columns = columns_for(width)
    return cells(of, columns)[[one.name for one in columns].index(column)]


@pytest.mark.parametrize("width", range(40, 260))
def test_the_table_fits_every_terminal(width: int) -> None:
    assert table_width(columns_for(width)) <= width


def test_nothing_important_is_missing_at_80_columns() -> None:
    important = {"id", "phase", "mode", "armed", "batt", "error", "age", "nearest", "flag"}
    assert important <= {column.name for column in columns_for(80)}
    assert {"PrC", "formation", "Hz", "late", "peers"} <= {column.name for column in columns_for(120)}
    assert columns_for(200)[-1].name == "event"


@pytest.mark.parametrize("flag", list(HealthFlag))
def test_every_flag_has_a_rank_and_is_shown_whole(flag: HealthFlag) -> None:
    assert code_table().worst_first.count(flag) == 1
    assert cell(row(flags=(flag,)), "flag", 80) == flag


def test_the_worst_flag_is_shown_with_the_number_of_the_others() -> None:
    assert cell(row(flags=(HealthFlag.LEADER_AWAITED, HealthFlag.OUTSIDE_FENCE)), "flag") == "OUTSIDE_FENCE +1"


def test_a_text_that_is_too_long_is_cut_visibly() -> None:
    assert cell(row(mode_name="AUTO.PRECLANDING"), "mode") == "AUTO.PRECLA…"


def test_the_nearest_vehicle_is_marked_while_the_filter_acts() -> None:
    assert cell(row(), "nearest") == "1:1.50m"
    assert cell(row(separation=SeparationReport(NearestVehicle("3", 1.23, 1.2), 0.5)), "nearest") == "!3:1.23m"
    assert cell(row(separation=SeparationReport(NearestVehicle("250", 12.3, 1.2), 0.5)), "nearest", 80) == "!250:12…"


def test_an_unknown_value_is_a_dash() -> None:
    unknown = row(battery_percent=None, reference_enu_m=None, position_error=None)
    assert [cell(unknown, name) for name in ("batt", "sigma", "flag")] == ["-", "-", "-"]


def test_an_old_position_has_no_value() -> None:
    old = row(state_age_s=1.5)
    assert [cell(old, name) for name in ("position", "error", "sigma", "age")] == ["-", "-", "-", "1.5s"]


@pytest.mark.parametrize(
    ("seconds", "shown"),
    [
        (0.0, "0ms"), (0.9994, "999ms"), (0.9996, "1.0s"), (99.94, "99.9s"), (99.96, "100s"), (599.9, "600s"),
        (600.0, "10min"), (5969.0, "99min"), (5970.0, "1.7h"), (99_999.0, "27.8h"), (1e6, "never"), (inf, "never"),
        (nan, "never"),
    ],
)  # fmt: skip
def test_a_duration_has_at_most_five_characters(seconds: float, shown: str) -> None:
    assert duration_text(seconds) == shown
    assert len(shown) <= 5


@pytest.mark.parametrize(
    ("metres", "shown"), [(0.126, "0.13m"), (9.994, "9.99m"), (9.996, "10.0m"), (99.96, "100m"), (1234.5, "1234m")]
)
def test_a_distance(metres: float, shown: str) -> None:
    assert metres_text(metres) == shown


@pytest.mark.parametrize(
    ("number", "shown"), [(9999, "9999"), (10_000, "10k"), (999_999, "999k"), (3_000_000, "3M"), (10**10, "many")]
)
def test_a_large_number(number: int, shown: str) -> None:
    assert count_text(number) == shown


@pytest.mark.parametrize("fleet", ["a*", "**", "a/b", "a?b", "", "Platoon", "a\nb", "-"])
def test_an_invalid_fleet_name_is_refused_in_one_line(fleet: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", f"--fleet={fleet}", "--once"]) == 2
    printed = capsys.readouterr().err
    assert "expected the name in a fleet file" in printed
    assert printed.count("\n") == 1


@pytest.mark.parametrize(
    "option",
    [
        "--control",
        "--listen=127.0.0.1:0",
        "--mavlink=udpout:127.0.0.1:14550",
        "--replay=flight",
        "--record=flight",
        "--tiles=map",
    ],
)
def test_options_of_the_page_are_refused_in_the_terminal(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", "--tui", option]) == 2
    name = option.partition("=")[0]
    assert capsys.readouterr().err.startswith(f"companion monitor: {name}: only for the live page")
