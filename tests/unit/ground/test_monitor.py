"""The table of the monitor."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from companion.cli.main import main
from companion.ground.fleet_status import VehicleRow
from companion.ground.monitor_table import cells, columns_for, note, plain_lines
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.notices import Code, Notice
from companion.types.separation import NearestVehicle, SeparationReport
from companion.types.status import NetworkState
from companion.wire.ground import Percentiles, Timing

NOTHING = Percentiles(0.0, 0.0, 0.0)
ROW = VehicleRow(
    fleet="platoon",
    vehicle_id=3,
    role=Role.FOLLOWER,
    phase=FlightPhase.FORMATION,
    mode_name="OFFBOARD",
    armed=True,
    position_enu_m=(1.0, 2.0, 2.504),
    prc=2,
    battery_percent=86.7,
    error_to_slot_m=0.126,
    hover_thrust_norm=0.4871,
    disturbance_enu_m_s2=(1.2, -1.6, 0.0),
    age_s=0.04,
    data_age_s=0.061,
    silent=False,
    neighbours=(2, 4),
    formation="1, then 2",
    reference="3",
    holder="anna@ground",
    flags=(),
    rejected=7,
    separation=SeparationReport(),
    last_event=Notice(Code.PHASE_CHANGED, "engage -> formation"),
    timing=Timing(50.0, 1, 0, NOTHING, NOTHING, 5.0, 49.0),
    network=NetworkState(),
)


def cell(row: VehicleRow, column: str) -> str:
    columns = columns_for(200)
    return cells(row, columns)[[one.name for one in columns].index(column)]


def test_a_flying_vehicle() -> None:
    assert cells(ROW, columns_for(200)) == [
        "3", "formation", "OFFBOARD", "armed", "87 %", "1.0 2.0 2.5", "0.13 m", "61 ms", "2", "1, then 2", "3", "7",
        "anna@ground", "0.49", "2.0 m/s2", "-",
    ]  # fmt: skip


def test_the_nearest_vehicle_is_marked_while_the_filter_acts() -> None:
    near = replace(ROW, separation=SeparationReport(NearestVehicle("3", 1.23, 1.2), 0.5))
    assert cells(near, columns_for(200))[-1] == "!3 1.2 m"


@pytest.mark.parametrize("width", [80, 100, 120, 150, 175])
def test_the_table_fits_the_terminal_and_uses_it(width: int) -> None:
    long = replace(
        ROW, vehicle_id=250, position_enu_m=(-1234.5, -1234.5, 123.4), mode_name="AUTO.PRECLAND", holder="a" * 63,
        formation="12 at -135 deg, then 13", reference="12, then 13, target 0.3 s old", error_to_slot_m=1234.5,
    )  # fmt: skip
    table = [line for line in plain_lines([ROW, long], width) if not line.startswith("  ")]
    assert max(map(len, table)) <= width
    assert len(columns_for(width)) > len(columns_for(width - 1)) or width == 80
    assert [column.name for column in columns_for(40)] == [column.name for column in columns_for(80)]


def test_a_text_that_is_too_long_is_cut_visibly() -> None:
    assert cell(replace(ROW, mode_name="AUTO.PRECLANDING"), "mode") == "AUTO.PRECLA…"


def test_each_fleet_has_a_table_and_a_heading() -> None:
    lines = list(plain_lines([replace(ROW, fleet="alpha"), ROW, replace(ROW, vehicle_id=4, silent=True)], 80))
    headings = [line for line in lines if line.startswith("fleet ")]
    assert headings == ["fleet alpha, 1 vehicle", "fleet platoon, 2 vehicles, SILENT: vehicle 4"]


@pytest.mark.parametrize(("column", "change"), [("error", "error_to_slot_m"), ("battery", "battery_percent")])
def test_an_unknown_value_is_a_dash(column: str, change: str) -> None:
    assert cell(replace(ROW, **{change: None}), column) == "-"  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("data_age_s", "shown"),
    [
        (0.0, "0 ms"),
        (0.9994, "999 ms"),
        (1.0, "1.0 s"),
        (75.26, "75.3 s"),
        (1e6, "never"),
        (inf, "never"),
        (nan, "never"),
    ],
)
def test_the_age_of_data(data_age_s: float, shown: str) -> None:
    assert cell(replace(ROW, data_age_s=data_age_s), "data") == shown


def test_silence_comes_before_flags_and_flags_before_events_in_a_note() -> None:
    flagged = replace(ROW, flags=(HealthFlag.OUTSIDE_FENCE, HealthFlag.LEADER_LOST))
    assert note(flagged) == "OUTSIDE_FENCE: outside the fence; LEADER_LOST: no fresh leader beacon"
    assert note(replace(flagged, silent=True, age_s=4.24)) == "SILENT for 4.2 s"
    assert note(ROW) == "PHASE_CHANGED: engage -> formation"
    assert note(replace(ROW, last_event=None)) == ""


def test_no_event_controls_the_terminal() -> None:
    hostile = replace(ROW, last_event=Notice(Code.PROCEDURE_FAILED, "\x1b[2J\x07arm: no\nroot\u202e"))
    assert note(hostile) == "PROCEDURE_FAILED: ?[2J?arm: no?root?"


@pytest.mark.parametrize("fleet", ["a*", "**", "a/b", "a?b", "", "Platoon", "a\nb", "-"])
def test_an_invalid_fleet_name_is_refused_in_one_line(fleet: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", f"--fleet={fleet}", "--once"]) == 2
    printed = capsys.readouterr().err
    assert "expected the name in a fleet file" in printed
    assert printed.count("\n") == 1


def test_a_fleet_that_strangers_can_command_is_named_in_its_heading() -> None:
    lines = list(plain_lines([ROW, replace(ROW, vehicle_id=4, network=NetworkState("none"))], 120))
    assert lines[0].endswith("UNSECURED (strangers can command): vehicle 4")
