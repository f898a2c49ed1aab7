"""Recordings as CSV files: names with units, one time for all vehicles."""

import csv
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from msgspec.structs import replace

from common import with_fields
from companion.cli.main import main
from companion.recording.reader import Recording
from companion.recording.records import DECISION, STATUS, DecisionRecord
from companion.tools.export import Table
from companion.types.autopilot import PositionError
from companion.types.formation import LeaderBeacon
from companion.types.notices import Code, Notice
from companion.types.status import NO_STATE_AGE_S
from companion.wire.messages import FlatReport, StatusReport, flat_report
from ground_fleet import DIRECTED_TIMING, directed_status
from recordings import HEADER, RecordingFile

DECISION_1 = DecisionRecord(
    now_s=101.0,
    phase="formation",
    role="follower",
    leader_id=None,
    epoch=0,
    prc=2,
    position_enu_m=(1.5, -2.0, 3.0),
    velocity_enu_m_s=(0.0, 0.0, 0.0),
    slot_offset_enu_m=(0.0, 0.0, 0.0),
    reference_enu_m=None,
    neighbours=(1, 3),
    weights=(0.75, 0.25),
    peer_ages_s=(0.02, 0.04),
    acceleration_enu_m_s2=(0.1, 0.2, 0.3),
    roll_deg=None,
    pitch_deg=-1.25,
    yaw_deg=None,
    thrust_norm=0.5,
    nearest="1",
    nearest_m=3.0,
    required_m=1.0,
    filter_changed_m_s2=0.0,
    wind_acceleration_enu_m_s2=(0.0, 0.0, 0.0),
    hover_thrust_norm=0.49,
    battery_percent=None,
    flags=("TICK_LATE", "BATTERY_LOW"),
)


def record(path: Path, vehicle_id: int = 1, unix_s: float = HEADER.unix_s, session: int = 1) -> None:
    file = RecordingFile(path, replace(HEADER, vehicle_id=vehicle_id, unix_s=unix_s, session=session))
    file.write(DECISION, 101.0, DECISION_1)
    file.write(DECISION, 101.02, replace(DECISION_1, roll_deg=2.5, flags=()))
    status = with_fields(
        directed_status(vehicle_id), described={"kind": "point", "pace": 1.5}, rejected={"a": 1, "b": 2}
    )
    file.write(STATUS, 101.0, StatusReport(status, DIRECTED_TIMING))
    file.close()


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_decisions_have_units_and_empty_cells(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "a.mcap")
    assert main(["export", str(tmp_path)]) == 0
    first, second = rows(tmp_path / "csv" / "vehicle-1_decision.csv")
    assert (first["time_s"], first["unix_s"]) == ("1.0", f"{HEADER.unix_s + 1.0}")
    assert (first["position_east_m"], first["position_north_m"], first["position_up_m"]) == ("1.5", "-2.0", "3.0")
    assert first["acceleration_up_m_s2"] == "0.3"
    assert (first["reference_east_m"], first["roll_deg"], first["pitch_deg"]) == ("", "", "-1.25")
    assert (first["neighbours"], first["weights"], first["flags"]) == ("1 3", "0.75 0.25", "TICK_LATE BATTERY_LOW")
    assert (second["roll_deg"], second["flags"], second["time_s"]) == ("2.5", "", "1.02")
    assert "vehicle-1_decision.csv: 2 rows" in capsys.readouterr().out


def test_position_and_velocity_are_empty_before_the_first_position(tmp_path: Path) -> None:
    file = RecordingFile(tmp_path / "a.mcap", HEADER)
    file.write(DECISION, 101.0, replace(DECISION_1, position_enu_m=None, velocity_enu_m_s=None))
    file.write(
        STATUS, 101.0, StatusReport(with_fields(directed_status(1), state_age_s=NO_STATE_AGE_S), DIRECTED_TIMING)
    )
    file.close()
    assert main(["export", str(tmp_path)]) == 0
    (decision,) = rows(tmp_path / "csv" / "vehicle-1_decision.csv")
    assert {decision[name] for name in ("position_east_m", "position_up_m", "velocity_north_m_s")} == {""}
    (row,) = rows(tmp_path / "csv" / "vehicle-1_status.csv")
    names = ("status_state_age_s", "status_position_east_m", "status_position_up_m", "status_velocity_north_m_s")
    assert {row[name] for name in names} == {""}
    assert row["status_reference_east_m"] == "0.0"


def test_an_interrupted_export_leaves_complete_files_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    record(tmp_path / "a.mcap")
    older = tmp_path / "csv" / "vehicle-1_status.csv"
    older.parent.mkdir()
    older.write_text("older")
    read = Recording.read

    def interrupted(self: Recording, topics: list[str], report: Callable[[str], None]) -> Iterator[object]:
        yield from read(self, topics, report)
        if STATUS in topics:
            raise KeyboardInterrupt

    monkeypatch.setattr(Recording, "read", interrupted)
    with pytest.raises(SystemExit, match="130"):
        main(["export", str(tmp_path)])
    assert {path.name for path in older.parent.iterdir()} == {"vehicle-1_decision.csv", older.name}
    assert older.read_text() == "older"
    assert "vehicle-1_decision.csv: 2 rows" in capsys.readouterr().out


def test_a_status_is_flat(tmp_path: Path) -> None:
    record(tmp_path / "a.mcap")
    assert main(["export", str(tmp_path / "a.mcap"), "--out", str(tmp_path / "out")]) == 0
    (row,) = rows(tmp_path / "out" / "vehicle-1_status.csv")
    assert row["status_phase"] == "observe"
    assert row["status_armed"] == "0"
    assert row["status_landed"] == "1"
    assert row["status_leader_beacon_leader_id"] == ""
    assert row["status_reference_east_m"] == "0.0"
    assert (row["status_described"], row["status_rejected"]) == ('{"kind":"point","pace":1.5}', "3")
    assert row["timing_late_us_p99"] == "2.0"


def test_cells_of_nested_values() -> None:
    table = Table(FlatReport)
    beacon, note = LeaderBeacon(3, 1, 2), Notice(Code.PEER_STALE, "text")
    full = with_fields(
        directed_status(2),
        leader_beacon=beacon,
        last_event=note,
        rejected={"A": 2, "B": 3},
        position_error=PositionError(0.1, 0.2),
    )
    cells = dict(zip(table.names, table.cells(flat_report(StatusReport(full, DIRECTED_TIMING))), strict=True))
    assert cells["status_leader_beacon_leader_id"] == 3
    assert cells["status_leader_beacon_heading_rate_rad_s"] == 0.0
    assert cells["status_last_event_code"] == "PEER_STALE"
    assert cells["status_rejected"] == 5
    assert cells["status_position_error_vertical_m"] == 0.2
    assert cells["status_lacks"] == ""
    assert len(set(table.names)) == len(table.names)


def test_vehicles_have_one_time(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "1.mcap")
    record(tmp_path / "2.mcap", vehicle_id=2, unix_s=HEADER.unix_s + 3.0)
    record(tmp_path / "3.mcap", vehicle_id=2, unix_s=HEADER.unix_s + 60.0, session=2)
    assert main(["export", str(tmp_path)]) == 0
    folder = tmp_path / "csv"
    assert [rows(folder / f"{name}_decision.csv")[0]["time_s"] for name in ("vehicle-1", "vehicle-2_start-1")] == [
        "1.0",
        "4.0",
    ]
    assert rows(folder / "vehicle-2_start-2_status.csv")[0]["time_s"] == "61.0"
    assert "vehicle 1: its clock cannot be compared" in capsys.readouterr().err


def test_damage_is_reported_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record(tmp_path / "vehicle_1_0001_001.mcap")
    data = (tmp_path / "vehicle_1_0001_001.mcap").read_bytes()
    (tmp_path / "vehicle_1_0001_001.mcap").write_bytes(data[:-40])
    assert main(["export", str(tmp_path)]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert "without its end" in line


def test_what_cannot_be_exported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path)]) == 2
    assert "no recordings here" in capsys.readouterr().err
    record(tmp_path / "ground.mcap", vehicle_id=0)
    assert main(["export", str(tmp_path)]) == 2
    assert "only the ground recorded here" in capsys.readouterr().err
    record(tmp_path / "a.mcap")
    (tmp_path / "file").write_text("")
    assert main(["export", str(tmp_path), "--out", str(tmp_path / "file")]) == 2
    assert "cannot be written" in capsys.readouterr().err
