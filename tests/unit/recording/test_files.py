"""Parts, their names, and how much of the disk recordings use."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from companion.config.vehicle import RecordingSettings
from companion.recording.files import TLOG, FlightFiles, PartFiles, TlogPart, recorded_files, recordings_folder
from recordings import Disk

LATER_S = 1e10  # by that time, all other flights are over


def files_in(
    folder: Path, keep_bytes: int = 10**9, part_bytes: int = 100, source: str = "vehicle_3"
) -> PartFiles[bytes]:
    return files_of(FlightFiles(folder, source, keep_bytes, lambda: LATER_S), part_bytes)


def files_of(flight: FlightFiles, part_bytes: int = 100) -> PartFiles[bytes]:
    return PartFiles(flight, TLOG, part_bytes, lambda _part: TlogPart())


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_part_ends_when_it_is_large_enough(tmp_path: Path) -> None:
    files = files_in(tmp_path)
    for _ in range(5):
        files.write(b"x" * 60)
    files.close()
    assert [(f.part, f.bytes) for f in sorted(recorded_files(tmp_path), key=lambda f: f.part)] == [
        (1, 120),
        (2, 120),
        (3, 60),
    ]


def test_flights_are_numbered_on(tmp_path: Path) -> None:
    for _ in range(2):
        files = files_in(tmp_path)
        files.write(b"x")
        files.close()
    other = files_in(tmp_path, source="vehicle_12")
    other.write(b"x")
    assert names(tmp_path) == ["vehicle_12_0001_001.tlog", "vehicle_3_0001_001.tlog", "vehicle_3_0002_001.tlog"]


def test_the_oldest_whole_flights_are_removed_first(tmp_path: Path) -> None:
    for flight in range(1, 5):
        for part in (1, 2):
            (tmp_path / f"vehicle_3_{flight:04d}_{part:03d}.mcap").write_bytes(b"x" * 100)
    (tmp_path / "notes.txt").write_bytes(b"x" * 10_000)
    files_in(tmp_path, keep_bytes=600).write(b"x" * 10)
    left = [name[:14] for name in names(tmp_path)]
    assert left == ["notes.txt", *["vehicle_3_0003"] * 2, *["vehicle_3_0004"] * 2, "vehicle_3_0005"]


def test_a_long_flight_loses_its_own_beginning(tmp_path: Path) -> None:
    files = files_in(tmp_path, keep_bytes=350)
    for _ in range(10):
        files.write(b"x" * 100)
        assert sum(file.bytes for file in recorded_files(tmp_path)) <= 350
    assert [file.part for file in sorted(recorded_files(tmp_path), key=lambda f: f.part)] == [8, 9, 10]


def test_a_flight_that_another_agent_records_stays(tmp_path: Path) -> None:
    other = tmp_path / "vehicle_4_0001_001.mcap"
    other.write_bytes(b"x" * 500)
    flight = FlightFiles(tmp_path, "vehicle_3", 300, lambda: other.stat().st_mtime + 5.0)
    PartFiles(flight, TLOG, 100, lambda _part: TlogPart()).write(b"x")
    assert other.exists()


def test_a_piece_that_does_not_fit_is_taken_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, files = Disk(monkeypatch), files_in(tmp_path, part_bytes=1000)
    files.write(b"a" * 10)
    disk.room = 4
    with pytest.raises(OSError) as raised:
        files.write(b"b" * 10)
    assert raised.value.errno == errno.ENOSPC
    assert (tmp_path / "vehicle_3_0001_001.tlog").read_bytes() == b"a" * 10
    disk.room = 100
    files.write(b"c" * 10)
    assert (tmp_path / "vehicle_3_0001_002.tlog").read_bytes() == b"c" * 10


def test_parts_that_cannot_begin_leave_no_files_and_no_gaps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    disk, files = Disk(monkeypatch), files_in(tmp_path)
    disk.room = 0
    for _ in range(3):
        with pytest.raises(OSError):
            files.write(b"x")
    disk.room = 100
    files.write(b"x")
    files.close()
    assert [file.part for file in recorded_files(tmp_path) if file.bytes] == [1]


def test_a_file_is_never_overwritten(tmp_path: Path) -> None:
    first, second = (FlightFiles(tmp_path, "vehicle_3", 10**9, lambda: LATER_S) for _ in range(2))
    assert first.path(1, TLOG) == second.path(1, TLOG)  # both choose the same number
    files_of(first).write(b"first")
    with pytest.raises(FileExistsError):
        files_of(second).write(b"second")
    assert (tmp_path / "vehicle_3_0001_001.tlog").read_bytes() == b"first"


def test_an_agent_records_where_it_is_told_else_in_the_state_folder() -> None:
    vehicle_file, state = Path("/etc/companion/vehicle-3.yaml"), {"STATE_DIRECTORY": "/var/lib/companion"}
    assert recordings_folder(vehicle_file, RecordingSettings(), state) == Path("/var/lib/companion/recordings")
    assert recordings_folder(vehicle_file, RecordingSettings(), {}) is None
    assert recordings_folder(vehicle_file, RecordingSettings(folder="here"), state) == Path("/etc/companion/here")
    assert recordings_folder(vehicle_file, RecordingSettings(enabled=False, folder="here"), state) is None


def test_files_are_not_for_everyone(tmp_path: Path) -> None:
    files_in(tmp_path).write(b"x")
    assert (tmp_path / "vehicle_3_0001_001.tlog").stat().st_mode & 0o007 == 0
