"""Logs of autopilots: read, aligned by motion, and judged."""

from __future__ import annotations

from pathlib import Path

import pytest
from msgspec.structs import replace

from companion.report.autopilot_logs import AutopilotLogs, LogError, log_files, match, read_log, read_logs
from companion.report.findings import Severity
from companion.report.load import StartRecords
from companion.report.summary import judge
from companion.types.autopilot import AutopilotKind
from companion.types.notices import Code
from made_flights import flight_of, records_of
from recordings import AT_S, DataflashNames, LoggedFaults, write_dataflash, write_ulog
from sitl.autopilots.autopilot import DT_S
from sitl.autopilots.types import AUTOPILOT_TYPES
from sitl.vehicle.config import AutopilotFile, StandIn

WRITERS = {".ulg": write_ulog, ".bin": write_dataflash}
CRITICAL, WARNING, _ = Severity


@pytest.fixture(scope="module")
def starts() -> list[StartRecords]:
    return records_of(2, 60.0)


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_log_is_aligned_by_its_motion(suffix: str, starts: list[StartRecords], tmp_path: Path) -> None:
    path = WRITERS[suffix](tmp_path / f"vehicle-2_log-1{suffix}", starts[1])
    found = match(read_log(path), flight_of(starts))
    assert found is not None
    assert found.vehicle_id == 2
    assert found.offset_s == pytest.approx(-AT_S, abs=0.06)
    assert found.agreement > 0.95


def test_a_log_across_the_180th_meridian_is_aligned(starts: list[StartRecords], tmp_path: Path) -> None:
    found = match(
        read_log(write_dataflash(tmp_path / "a.bin", starts[1], origin_longitude_deg=180.0)), flight_of(starts)
    )
    assert found is not None
    assert found.agreement > 0.95


@pytest.mark.parametrize("suffix", WRITERS)
def test_voltage_vibration_and_satellites_are_read(suffix: str, starts: list[StartRecords], tmp_path: Path) -> None:
    log = read_log(WRITERS[suffix](tmp_path / f"a{suffix}", starts[0], LoggedFaults(satellites=lambda _: 11)))
    assert log.voltage_v.values[0] == pytest.approx(16.4, abs=0.02)
    assert log.vibration_m_s2.values.max() == pytest.approx(2.0)
    assert set(log.satellites.values) == {11.0}
    assert log.altitude_m.values.size == log.velocity_enu_m_s.shape[0]


@pytest.mark.parametrize("suffix", WRITERS)
def test_what_the_autopilot_did_by_itself_is_found(suffix: str, starts: list[StartRecords], tmp_path: Path) -> None:
    faults = LoggedFaults(
        vibration_m_s2=lambda time_s: 45.0 if 20.0 <= time_s < 24.0 else 2.0,
        satellites=lambda time_s: 4 if 30.0 <= time_s < 33.0 else 14,
        failsafe=lambda time_s: 40.0 <= time_s < 42.0,
    )
    path = WRITERS[suffix](tmp_path / f"vehicle-1_log-1{suffix}", starts[0], faults)
    flight = flight_of(starts)
    findings = judge(flight, read_logs([path], flight)).summary.findings
    assert [(one.severity, one.code, round(one.time_s)) for one in findings] == [
        (CRITICAL, Code.AUTOPILOT_FAILSAFE, 40),
        (WARNING, Code.VIBRATION_HIGH, 20),
        (WARNING, Code.GPS_POOR, 30),
    ]


@pytest.mark.parametrize(
    "names",
    [
        DataflashNames(primary=lambda time_s: int(time_s > 30.0)),
        DataflashNames(primary=lambda time_s: int(time_s > 30.0), position=False),
        DataflashNames(primary=lambda _: 1, position=False),
        DataflashNames(primary=lambda time_s: int(20.0 < time_s < 40.0), position=False, filter="NKF"),
    ],
    ids=["POS beside it", "lane switch", "the second core", "EKF2, there and back"],
)
def test_a_log_is_matched_by_the_core_that_was_flown(
    names: DataflashNames, starts: list[StartRecords], tmp_path: Path
) -> None:
    found = match(read_log(write_dataflash(tmp_path / "vehicle-2_a.bin", starts[1], names=names)), flight_of(starts))
    assert found is not None
    assert found.vehicle_id == 2
    assert found.offset_s == pytest.approx(-AT_S, abs=0.06)
    assert found.agreement > 0.95


@pytest.mark.parametrize("instance", ["Inst", "Instance"])
def test_the_first_battery_counts_by_the_names_of_all_versions(
    instance: str, starts: list[StartRecords], tmp_path: Path
) -> None:
    log = read_log(write_dataflash(tmp_path / "a.bin", starts[0], names=DataflashNames(instance=instance)))
    assert log.voltage_v.values.min() > 15.0


ENTER, ENTER_HOLD, GENERIC, OF_ANOTHER_VERSION = 0x0194CA8A, 0x01D11DF6, 0x01DEDBD0, 0x01AB1234


@pytest.mark.parametrize(
    ("logged", "text"),
    [
        (
            {"events": ((40.0, ENTER, 0x42, b"\0\0\0\0\x06\x02"),)},
            "failsafe: GCS connection loss; action: return",
        ),
        (
            {"events": ((40.0, ENTER_HOLD, 0x42, b"\0\0\0\0\x07\x05\0\x03"),), "nav_state": 4},
            "failsafe: low battery level; action: hold",
        ),
        (
            {
                "events": ((40.0, GENERIC, 0x42, b"\0\0\0\0\x07"),),
                "flags": lambda time_s: (time_s > 36.0, 0),
            },
            "failsafe: manual control signal lost; action: land",
        ),
        (
            {"events": ((40.0, OF_ANOTHER_VERSION, 0x42, b"\0\0\0\0\x07\x01"),), "nav_state": 5},
            "failsafe: manual control loss; action: return",
        ),
        (
            {"flags": lambda time_s: (True, 2 if time_s > 39.5 else 1), "nav_state": 18},
            "failsafe: critical battery level; action: land",
        ),
        ({"flags": lambda _: (True, 0), "nav_state": 5}, "failsafe: no cause logged; action: return"),
        (
            {"events": ((40.0, OF_ANOTHER_VERSION, 0x64, b"\0\0\0\0\x07\x01"), (40.0, ENTER, 0x42, b"\xff" * 25))},
            "failsafe (vehicle_status.failsafe); the log says neither cause nor action",
        ),
    ],
)
def test_cause_and_action_of_a_px4_failsafe_are_named(
    logged: dict[str, object], text: str, starts: list[StartRecords], tmp_path: Path
) -> None:
    messages = ((40.0, 2, "[commander] Failsafe activated\t"),)
    faults = LoggedFaults(failsafe=lambda time_s: 40.0 <= time_s < 42.0, messages=messages, **logged)  # type: ignore[arg-type]
    path = write_ulog(tmp_path / "vehicle-1_a.ulg", starts[0], faults)
    flight = flight_of(starts)
    findings = judge(flight, read_logs([path], flight)).summary.findings
    assert [(one.code, round(one.time_s), one.text) for one in findings] == [(Code.AUTOPILOT_FAILSAFE, 40, text)]


def test_a_failsafe_of_a_log_without_status_is_that_of_its_event(starts: list[StartRecords], tmp_path: Path) -> None:
    path = write_ulog(
        tmp_path / "vehicle-1_a.ulg", starts[0], LoggedFaults(events=((40.0, ENTER, 0x42, b"\0\0\0\0\x08\x04"),))
    )
    (message,) = read_log(path).messages
    assert message.text == "failsafe: critical battery level; action: descend"


def test_a_repeated_warning_is_one_finding_and_those_on_the_ground_are_none(
    starts: list[StartRecords], tmp_path: Path
) -> None:
    messages = ((1.0, 4, "not ready"), (20.0, 4, "wind is high"), (25.0, 4, "wind is high"), (26.0, 6, "a note"))
    path = write_ulog(tmp_path / "vehicle-1_a.ulg", starts[0], LoggedFaults(messages=messages))
    flight = flight_of(starts)
    findings = judge(flight, read_logs([path], flight)).summary.findings
    assert [(one.code, one.text) for one in findings] == [(Code.AUTOPILOT_MESSAGE, "wind is high")]


def test_a_log_of_another_flight_is_left_out(starts: list[StartRecords], tmp_path: Path) -> None:
    other = records_of(1, 300.0)[0]
    mirrored = [
        replace(record, position_enu_m=(record.position_enu_m[0], -record.position_enu_m[1], 5.0))
        for record in other.decisions[5000:8000]
    ]
    path = write_ulog(tmp_path / "a.ulg", StartRecords(other.header, mirrored))
    flight = flight_of([starts[0]])
    assert match(read_log(path), flight) is None
    logs = read_logs([path], flight)
    assert [one.code for one in logs.left_out] == [Code.LOG_NOT_ALIGNED]


@pytest.mark.parametrize("name", ["a.ulg", "a.bin", "a.txt"])
def test_a_damaged_log_is_a_finding_that_names_the_file(name: str, tmp_path: Path, starts: list[StartRecords]) -> None:
    path = tmp_path / name
    path.write_bytes(b"no log at all" * 100)
    with pytest.raises(LogError):
        read_log(path)
    logs = read_logs([path], flight_of(starts))
    assert logs == AutopilotLogs((), logs.left_out)
    assert [(one.code, one.text.startswith(name)) for one in logs.left_out] == [(Code.LOG_UNREADABLE, True)]


@pytest.mark.parametrize("suffix", WRITERS)
def test_a_truncated_log_is_read_up_to_there(suffix: str, starts: list[StartRecords], tmp_path: Path) -> None:
    path = WRITERS[suffix](tmp_path / f"vehicle-1_log-1{suffix}", starts[0])
    content = path.read_bytes()
    path.write_bytes(content[: len(content) * 3 // 4])
    found = match(read_log(path), flight_of(starts))
    assert found is not None
    assert found.offset_s == pytest.approx(-AT_S, abs=0.06)


@pytest.mark.parametrize(("kind", "suffix"), [(AutopilotKind.PX4, ".ulg"), (AutopilotKind.ARDUPILOT, ".bin")])
def test_logs_of_the_stand_ins_are_read(kind: AutopilotKind, suffix: str, tmp_path: Path) -> None:
    file = AutopilotFile(id=1, stand_in=StandIn(autopilot=kind, sensors="ideal", armable_after_s=0.0))
    autopilot = AUTOPILOT_TYPES[kind].vehicle(file, DT_S)
    autopilot.armed = True
    for _ in range(round(3.0 / DT_S)):
        autopilot.step()
        autopilot.flight_logs.write(autopilot)
    path = tmp_path / f"a{suffix}"
    path.write_bytes(autopilot.flight_logs.files[0].content)
    log = read_log(path)
    assert log.altitude_m.values.size > 20


def test_logs_in_the_folder_are_found_where_they_are_not_named(tmp_path: Path) -> None:
    inside, outside = tmp_path / "flight" / "logs" / "a.ULG", tmp_path / "b.bin"
    inside.parent.mkdir(parents=True)
    for path in (inside, outside, inside.with_name("eeprom.bin")):  # the last has parameters of ArduPilot's simulation
        path.touch()
    folder = tmp_path / "flight"
    assert log_files(folder, [outside]) == (inside,)
    assert log_files(folder, [outside, folder / ".." / "flight" / "logs" / "a.ULG"]) == ()
