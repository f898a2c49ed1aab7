"""`companion report` with files: exit codes, JSON, damage, and what it prints."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import pytest
from msgspec.structs import replace

import companion.report.load as load
from companion.cli.main import main
from companion.recording.records import DecisionRecord
from companion.report.flight_findings import refused_commands
from companion.report.load import StartRecords
from companion.types.commands import CommandName
from companion.types.notices import Code, Notice
from made_flights import BEGIN_UNIX_S, Faults, flight_of, records_of, write_recordings

SECONDS = 24.0


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two vehicles, a good flight; with its report."""
    folder = tmp_path_factory.mktemp("good")
    write_recordings(folder, records_of(2, SECONDS))
    return folder


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of the findings: the figures have tests of their own, and take seconds."""
    monkeypatch.setattr("companion.report.page.sections_of", lambda _one, _axis: [])


def codes(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, list[tuple[str, int | None]]]:
    """(exit code, codes and vehicles of the findings)."""
    capsys.readouterr()
    exit_code = main(["report", str(folder), "--json"])
    printed = json.loads(capsys.readouterr().out)
    return exit_code, [(one["code"], one["vehicle_id"]) for one in printed["findings"]]


def test_a_good_flight_gives_a_page_and_exit_code_0(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(flown)]) == 0
    printed = capsys.readouterr()
    assert printed.out == ""
    assert "No findings" in printed.err.splitlines()[-1]
    assert str(flown / "report.html") in printed.err
    assert "No findings: no vehicles came too close" in (flown / "report.html").read_text(encoding="utf-8")


def test_json_has_figures_of_every_vehicle(flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(flown), "--json", "--out", str(tmp_path / "a.html")]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert (printed["version"], printed["fleet"], printed["findings"]) == (1, "golden", [])
    assert printed["begin_unix_s"] == pytest.approx(BEGIN_UNIX_S, abs=0.05)
    assert printed["lasts_s"] == pytest.approx(SECONDS, abs=0.1)
    assert printed["smallest_separation"]["pair"] == [1, 2]
    assert printed["smallest_separation"]["distance_m"] == pytest.approx(3.05, abs=0.01)
    first, second = printed["vehicles"]
    assert (first["vehicle_id"], first["error_max_m"], first["commands"], first["refused"]) == (1, 0.0, 5, 0)
    assert second["error_max_m"] == pytest.approx(0.05, abs=0.01)
    assert second["in_formation_s"] == pytest.approx(6.0, abs=0.1)
    assert (tmp_path / "a.html").exists()


@pytest.mark.usefixtures("no_figures")
def test_critical_findings_are_exit_code_1(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    failed = Faults(events=((12.0, Notice(Code.AGENT_FAILED, "ValueError: a defect")),))
    write_recordings(tmp_path, records_of(2, SECONDS, {2: failed}))
    assert codes(tmp_path, capsys) == (1, [("AGENT_FAILED", 2)])


@pytest.mark.usefixtures("no_figures")
def test_a_truncated_file_is_read_as_far_as_possible(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    _, path = write_recordings(tmp_path, records_of(2, SECONDS))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    exit_code, found = codes(tmp_path, capsys)
    assert exit_code == 1
    assert found == [("RECORDING_ENDS_IN_AIR", 2), ("RECORDING_TRUNCATED", 2)]


@pytest.mark.usefixtures("no_figures")
def test_two_starts_of_one_vehicle_are_one_vehicle(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recordings(tmp_path, records_of(2, SECONDS, {2: Faults(restart_s=(12.0, 13.0))}))
    assert codes(tmp_path, capsys) == (1, [("AGENT_RESTARTED", 2)])


@pytest.mark.usefixtures("no_figures")
def test_a_missing_vehicle_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    missing, *others = records_of(3, SECONDS)
    write_recordings(tmp_path, others)
    assert codes(tmp_path, capsys) == (0, [("RECORDING_MISSING", missing.header.vehicle_id)])


@pytest.mark.usefixtures("no_figures")
def test_vehicles_that_never_met_are_not_aligned(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number, start in enumerate(records_of(2, SECONDS)):
        write_recordings(tmp_path / str(number), [start])
    exit_code, found = codes(tmp_path, capsys)
    assert (exit_code, found) == (0, [("CLOCK_NOT_ALIGNED", 1), ("CLOCK_NOT_ALIGNED", 2)])


def later(starts: list[StartRecords], by_s: float, session: int) -> list[StartRecords]:
    """The same flight again, by the dates of the vehicles."""
    headers = [replace(start.header, unix_s=start.header.unix_s + by_s, session=session) for start in starts]
    return [dataclasses.replace(start, header=header) for start, header in zip(starts, headers, strict=True)]


def test_of_flights_on_several_days_the_last_is_reported(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """As after `scp` of all that the boards have."""
    first = records_of(2, SECONDS)
    write_recordings(tmp_path / "first", first)
    write_recordings(tmp_path / "second", later(first, 172_800.0, 9))
    main(["report", str(tmp_path), "--json"])
    printed = json.loads(capsys.readouterr().out)
    assert printed["begin_unix_s"] == pytest.approx(BEGIN_UNIX_S + 172_800.0, abs=0.1)
    assert printed["lasts_s"] == pytest.approx(SECONDS, abs=0.1)
    (found,) = printed["findings"]
    assert found["code"] == "RECORDING_UNREADABLE"
    assert "2 recordings of more than an hour before or after this flight" in found["text"]


@pytest.mark.usefixtures("no_figures")
def test_a_vehicle_of_1970_that_never_met_the_others_ends_no_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    *others, alone = records_of(3, SECONDS)
    write_recordings(tmp_path / "others", others)
    write_recordings(tmp_path / "alone", later([alone], -BEGIN_UNIX_S, 1))
    exit_code, found = codes(tmp_path, capsys)
    assert (exit_code, set(found)) == (0, {("RECORDING_MISSING", 3), ("RECORDING_UNREADABLE", None)})


def test_records_of_many_days_are_refused_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (start,) = records_of(1, SECONDS)
    start.decisions.append(replace(start.decisions[-1], now_s=start.decisions[-1].now_s + 1e9))
    write_recordings(tmp_path, [start])
    assert main(["report", str(tmp_path)]) == 2
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.endswith("its records span more than 24 hours; give the folder of one flight")


@pytest.mark.usefixtures("no_figures")
def test_values_that_no_vehicle_has_are_left_out(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    def far(time_s: float, record: DecisionRecord) -> DecisionRecord:
        return replace(record, position_enu_m=(1e308, -1e308, 1e300), nearest_m=1e308) if time_s > 15.0 else record

    write_recordings(tmp_path, records_of(2, SECONDS, {2: Faults(decision=far)}))
    assert codes(tmp_path, capsys) == (0, [])


def test_a_recording_of_very_many_records_is_read_up_to_a_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(load.MOST, load.STATUS, 100)
    write_recordings(tmp_path, records_of(1, SECONDS))
    main(["report", str(tmp_path), "--json"])
    texts = [one["text"] for one in json.loads(capsys.readouterr().out)["findings"]]
    assert "after 100 records of /status the rest of the recording is left out" in texts


@pytest.mark.usefixtures("no_figures")
def test_another_file_in_the_folder_is_a_finding(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_recordings(tmp_path, records_of(1, SECONDS))
    (tmp_path / "notes.mcap").write_text("no recording")
    assert codes(tmp_path, capsys) == (0, [("RECORDING_UNREADABLE", None)])


def test_an_empty_folder_is_exit_code_2_with_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"companion report: {tmp_path}: no recordings here")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("missing.bin", None, "cannot be read: No such file or directory"),
        ("notes.md", b"no log", "expected a name that ends in .ulg (PX4) or .bin (ArduPilot)"),
        ("damaged.ulg", b"no log at all", "not a ULog that can be read"),
    ],
)
def test_a_named_log_that_cannot_be_used_is_exit_code_2_before_the_work(
    name: str, content: bytes | None, reason: str, flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if content is not None:
        (tmp_path / name).write_bytes(content)
    assert main(["report", str(flown), "--log", str(tmp_path / name), "--out", str(tmp_path / "a.html")]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"companion report: {tmp_path / name}: {reason}")
    assert not (tmp_path / "a.html").exists()


@pytest.mark.usefixtures("no_figures")
def test_a_log_in_the_folder_that_cannot_be_read_is_a_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_recordings(tmp_path, records_of(1, SECONDS))
    (tmp_path / "damaged.ulg").write_text("no log at all")
    assert codes(tmp_path, capsys) == (0, [("LOG_UNREADABLE", None)])


@pytest.mark.parametrize("out", ["missing/a.html", ""])
def test_a_page_that_cannot_be_written_is_found_before_the_work(
    out: str, flown: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(flown), "--out", str(tmp_path / out)]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "cannot be written: " in line


def test_a_page_that_cannot_be_written_is_exit_code_2(flown: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(flown), "--out", str(flown / "missing" / "a.html")]) == 2
    assert "cannot be written: No such file or directory; choose another file with --out" in capsys.readouterr().err


def test_a_refusal_that_was_accepted_soon_after_is_information() -> None:
    start = records_of(1, SECONDS, {1: Faults(refused={CommandName.ARM: Code.WRONG_PHASE})})[0]
    again_s = 1.2
    repeated = [(now_s + again_s, command) for now_s, command in start.commands if command.name is CommandName.ARM]
    start.commands.extend((now_s, replace(command, number=50)) for now_s, command in repeated)
    answers = [reply for _, reply in start.replies if reply.number == 2]
    start.replies.extend(
        (repeated[0][0] + 0.01, replace(reply, number=50, accepted=True, code=Code.PHASE_CHANGED)) for reply in answers
    )
    (vehicle,) = flight_of([start]).vehicles
    (found,) = refused_commands(vehicle)
    assert (found.severity, found.code) == ("info", Code.WRONG_PHASE)
    assert found.text.endswith("; accepted 1.2 s later")
