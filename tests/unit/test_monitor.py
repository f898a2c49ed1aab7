"""What a row of the monitor says."""

from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import pytest

from companion.cli import main
from companion.ground.fleet_status import VehicleRow
from companion.ground.monitor import COLUMNS, cells
from companion.types import FlightPhase, HealthFlag, Role
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
    error_to_slot_m=0.126,
    hover_thrust_norm=0.4871,
    disturbance_enu_m_s2=(1.2, -1.6, 0.0),
    age_s=0.04,
    data_age_s=0.061,
    silent=False,
    neighbours=(2, 4),
    formation="1, 2 to come",
    reference="3",
    holder="anna@ground",
    flags=(),
    rejected=7,
    last_event="engage -> formation",
    timing=Timing(50.0, 1, 0, NOTHING, NOTHING, 5.0, 49.0),
)


def cell(row: VehicleRow, column: str) -> str:
    return cells(row, several_fleets=False)[COLUMNS.index(column)]


def test_a_flying_vehicle() -> None:
    assert cells(ROW, several_fleets=False) == (
        "3", "formation", "OFFBOARD", "armed", "2.50 m", "2", "0.13 m", "0.49, 2.0 m/s2", "61 ms", "7",
        "1, 2 to come", "3", "anna@ground", "engage -> formation",
    )  # fmt: skip


def test_of_several_fleets_the_name_stands_with_the_vehicle() -> None:
    assert cells(ROW, several_fleets=True)[0] == "platoon/3"


def test_no_error_is_a_dash() -> None:
    assert cell(replace(ROW, error_to_slot_m=None), "error") == "-"


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


def test_what_is_wrong_comes_before_what_happened_and_silence_before_both() -> None:
    flagged = replace(ROW, flags=(HealthFlag.FENCE, HealthFlag.LEADER_LOST))
    assert cell(flagged, "what") == f"{HealthFlag.FENCE}; {HealthFlag.LEADER_LOST}"
    assert cell(replace(flagged, silent=True, age_s=4.24), "what") == "SILENT for 4.2 s"


def test_nothing_in_an_event_steers_the_terminal() -> None:
    hostile = replace(ROW, last_event="\x1b[2J\x07arm: no\nroot\u202e")
    assert cell(hostile, "what") == "?[2J?arm: no?root?"


@pytest.mark.parametrize("fleet", ["a*", "**", "a/b", "a?b", "", "Platoon", "a\nb", "-"])
def test_what_is_no_fleets_name_is_refused_in_one_line(fleet: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["monitor", f"--fleet={fleet}", "--once"]) == 2
    printed = capsys.readouterr().err
    assert "expected the name in a fleet file" in printed
    assert printed.count("\n") == 1
