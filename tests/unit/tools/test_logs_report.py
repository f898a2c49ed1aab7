"""Selection of flight logs, file names, and complete downloads."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import pytest

from companion.link.flight_logs import FlightLogsError, LogEntry
from companion.tools.logs import NoSuchLogError, choose, file_name, give_name, progress_text, size_text
from companion.types.autopilot import AutopilotKind

PX4, ARDUPILOT = AutopilotKind.PX4, AutopilotKind.ARDUPILOT


def at(minute: int) -> datetime:
    return datetime(2026, 11, 21, 18, minute, 5, tzinfo=UTC)


# As PX4's card may list them: the newest in the middle, and one of before the clock was set.
LOGS = (LogEntry(0, at(10), 100), LogEntry(1, at(30), 200), LogEntry(2, at(20), 300), LogEntry(3, None, 400))


def test_selected_logs_are_unique_and_in_list_order() -> None:
    assert choose(LOGS, (2, 0, 2), PX4) == (LOGS[0], LOGS[2])
    assert choose(LOGS, ("all", 1), PX4) == LOGS
    assert choose(LOGS, (1, "last"), PX4) == (LOGS[1],)
    assert choose(LOGS, (), PX4) == ()


def test_last_log_is_newest_by_date_on_px4_and_by_number_on_ardupilot() -> None:
    assert choose(LOGS, ("last",), PX4) == (LOGS[1],)
    assert choose(LOGS, ("last",), ARDUPILOT) == (LOGS[3],)
    undated = tuple(LogEntry(number, None, 1) for number in range(3))
    assert choose(undated, ("last",), PX4) == (undated[2],)


def test_missing_log_is_named_with_the_available_ones() -> None:
    with pytest.raises(NoSuchLogError, match=r"^no log 5, 10; there are 0 to 3$"):
        choose(LOGS, (10, 5, 1), PX4)
    with pytest.raises(NoSuchLogError, match=r"^no log 2; there is only 0$"):
        choose(LOGS[:1], (2,), PX4)


def test_file_name_has_vehicle_date_and_number() -> None:
    assert file_name(12, LOGS[1], PX4) == Path("vehicle-12_2026-11-21_18-30-05_log-1.ulg")
    assert file_name(1, LOGS[3], ARDUPILOT) == Path("vehicle-1_log-3.bin")


def test_sizes_are_formatted() -> None:
    assert [size_text(n) for n in (0, 999, 1000, 46_080, 2_695_249)] == ["0 B", "999 B", "1.0 kB", "46.1 kB", "2.7 MB"]
    assert progress_text(LogEntry(3, None, 2_000_000), 500_000, 2.0) == "log 3:  25 % of 2.0 MB, 250.0 kB/s"


def test_file_is_renamed_only_when_complete(tmp_path: Path) -> None:
    part, file = tmp_path / "log.part", tmp_path / "log"
    part.write_bytes(b"123")
    with pytest.raises(FlightLogsError, match="3 of 4 bytes were written; is the disk full"):
        give_name(part, file, size_bytes=4)
    assert not file.exists()
    give_name(part, file, size_bytes=3)
    assert file.read_bytes() == b"123"
    assert not part.exists()


@pytest.mark.parametrize("autopilot", [PX4, ARDUPILOT])
def test_last_log_is_the_newest_with_content(autopilot: AutopilotKind) -> None:
    logs = (LogEntry(248, at(10), 100), LogEntry(250, at(20), 200), LogEntry(251, at(30), 0), LogEntry(252, None, 0))
    assert choose(logs, ("last",), autopilot) == (logs[1],)
    with pytest.raises(NoSuchLogError, match=r"^no log 249; there are 248, 250 to 252$"):
        choose(logs, (249,), autopilot)
    with pytest.raises(NoSuchLogError, match=r"^all logs are empty$"):
        choose(logs[2:], ("last",), autopilot)
