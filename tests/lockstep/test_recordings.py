"""Flights in virtual time leave the same recordings each time, and recording changes no flight."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

from companion.recording.reader import recordings
from companion.recording.records import INBOX
from sitl.flight.scenario import Scenario, load_scenario
from sitl.flight.virtual_flight import fly_in_virtual_time
from sitl.report.progress import FlightProgress

PLATOON = Path(__file__).parents[2] / "config/scenarios/platoon.yaml"


def scenario(*overrides: str) -> Scenario:
    return load_scenario(PLATOON, ["stand_in.sensors=default", "timeline[3].for_s=5.0", *overrides])


def flown(flight: Scenario, folder: Path | None) -> list[object]:
    """The true tracks."""
    quiet = FlightProgress("", True, began_s=0.0)
    with quiet:
        result = fly_in_virtual_time(flight, quiet, recordings=folder)
    assert result.failure is None
    return list(result.tracks().values())


def test_two_flights_leave_the_same_bytes_and_fly_as_without(tmp_path: Path) -> None:
    folders = [tmp_path / "first", tmp_path / "second"]
    tracks = [flown(scenario(), folder) for folder in (*folders, None)]
    assert repr(tracks[0]) == repr(tracks[1]) == repr(tracks[2])
    files = [{path.name: path.read_bytes() for path in folder.iterdir()} for folder in folders]
    assert sorted(files[0]) == [f"vehicle_{i}_0001_001.mcap" for i in (1, 2, 3, 4)]
    assert files[0] == files[1]
    for recorded in recordings(folders[0], print):
        messages = list(recorded.undecoded([INBOX], print))
        assert [message.sequence for message in messages] == list(range(1, len(messages) + 1))
        assert all(a.log_time_ns < b.log_time_ns for a, b in pairwise(messages))


def test_an_agent_that_starts_again_records_another_flight(tmp_path: Path) -> None:
    ends = "agent_ends=[{vehicle: 2, at_s: 1.0, restarts_after_s: 1.0}]"
    flown(scenario(ends), tmp_path)
    sessions = {recorded.header.session for recorded in recordings(tmp_path, print) if recorded.vehicle_id == 2}
    assert sessions == {1, 2}
    assert {path.name for path in tmp_path.glob("vehicle_2_*")} == {f"vehicle_2_000{i}_001.mcap" for i in (1, 2)}
