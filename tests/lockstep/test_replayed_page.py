"""A flight in virtual time, recorded by its agents: shown again by `companion monitor --replay`, and its report."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from common import ROOT
from companion.cli.main import main
from companion.monitor.api import Snapshot
from companion.monitor.recordings import NoFlightError, read_flight
from companion.monitor.snapshot import Picture
from companion.recording.reader import RecordingError
from companion.types.commands import CommandReply
from companion.types.flight import FlightPhase
from companion.types.notices import Code
from made_flights import records_of, write_recordings
from sitl.flight.scenario import load_scenario
from sitl.flight.virtual_flight import Flown, fly_in_virtual_time
from sitl.report.progress import FlightProgress

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> tuple[Flown, Path]:
    folder = tmp_path_factory.mktemp("recordings")
    scenario = load_scenario(PLATOON, ["timeline[3].for_s=4"])
    return fly_in_virtual_time(scenario, FlightProgress("test", True, 0.0), recordings=folder), folder


class Shown:
    """A recording, played step by step by a clock of the test."""

    def __init__(self, folder: Path) -> None:
        self._now_s = 0.0
        warnings: list[str] = []
        self.flight = read_flight(folder, warnings.append, lambda: self._now_s)
        assert warnings == []
        self.picture = Picture(self.flight.fleets, "")

    def play(self, seconds: float) -> Snapshot:
        """The last snapshot of these seconds."""
        source = self.flight.source
        for _ in range(int(seconds * 10)):
            self._now_s += 0.1
            self.picture.receive(source.drain())
            for happening in source.drain_happenings():
                self.picture.events.add(happening)
            snapshot = self.picture.snapshot(*source.moment())
        return snapshot


def test_it_has_the_fleet_file_and_every_vehicle(flight: tuple[Flown, Path]) -> None:
    shown = Shown(flight[1])
    assert list(shown.flight.fleets) == ["platoon"]
    snapshot = shown.play(2.0)
    assert [v.vehicle_id for v in snapshot.vehicles] == sorted(flight[0].tracks())
    assert not any(v.silent for v in snapshot.vehicles)


def test_the_whole_flight_is_in_its_timeline(flight: tuple[Flown, Path]) -> None:
    shown = Shown(flight[1])
    replay = shown.flight.source.replay
    snapshot = shown.play(replay.end_s - replay.begin_s + 1.0)
    events = shown.picture.events.all()
    phases = [e.text for e in events if e.kind == "phase" and e.vehicle_id == 1]
    assert any(FlightPhase.FORMATION in text for text in phases)
    exchanged = [e for e in events if e.kind in ("command", "answer") and e.vehicle_id == 1]
    given = [e.code for e in exchanged if e.kind == "command"]
    assert given == ["prepare", "arm", "takeoff", "form", "land"]
    assert [e.kind for e in exchanged] == ["command", "answer"] * 5
    points = shown.picture.history().points
    assert any(v.error_to_slot_m is not None for point in points for v in point.vehicles)
    assert not any(v.armed for v in snapshot.vehicles)


def test_an_answer_to_a_check_is_no_command_of_the_timeline(tmp_path: Path) -> None:
    """`--check` and the previews of the page; the file has its answer, and no command."""
    (start,) = records_of(1, 30.0)
    now_s = start.span_s[0] + 15.0
    check = CommandReply(1, 1_700_000_000_000, False, Code.SLOT_TOO_CLOSE, "too close", "anna@ground")
    start.replies.append((now_s, check))
    write_recordings(tmp_path, [start])
    shown = Shown(tmp_path)
    shown.play(32.0)
    exchanged = [e for e in shown.picture.events.all() if e.kind in ("command", "answer")]
    assert len(exchanged) == 2 * len({command.number for _, command in start.commands})
    assert {e.outcome for e in exchanged if e.kind == "answer"} == {"accepted"}


def test_a_damaged_file_is_named_once(tmp_path: Path) -> None:
    (file,) = write_recordings(tmp_path, records_of(1, 30.0))
    file.write_bytes(file.read_bytes()[:-40])
    warnings: list[str] = []
    read_flight(tmp_path, warnings.append)
    assert len(warnings) == 1
    assert "without its end" in warnings[0]


def test_the_report_of_the_flight_has_no_findings(
    flight: tuple[Flown, Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["report", str(flight[1]), "--json", "--out", str(tmp_path / "report.html")]) == 0
    assert json.loads(capsys.readouterr().out)["findings"] == []


def test_a_folder_without_a_recording_is_one_line(tmp_path: Path) -> None:
    with pytest.raises((RecordingError, NoFlightError)) as raised:
        read_flight(tmp_path, print)
    assert "\n" not in str(raised.value)


def test_more_statuses_than_can_be_shown_are_one_line(
    flight: tuple[Flown, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("companion.monitor.recordings.MOST_REPORTS", 50)
    with pytest.raises(NoFlightError, match="has more statuses than are shown at once, 50") as raised:
        read_flight(flight[1], print)
    assert "\n" not in str(raised.value)
