"""The file that an agent keeps of a take-off: what is written when, and what of it is believed."""

from __future__ import annotations

import logging
import os
from pathlib import Path

import msgspec
import pytest
from msgspec.structs import replace

from companion.config.vehicle import AgentConfig, VehicleConfig
from companion.core.estimation.vehicle import VehicleTracker
from companion.link.takeoff_file import KEPT_EVERY_S, KeptTakeoff, TakeoffFile, takeoff_path
from companion.types.autopilot import (
    AutopilotKind,
    GroundSample,
    HeartbeatSample,
    LandedSample,
    LandedState,
    OriginSample,
    PositionSample,
)
from one_agent import FLEET

ORIGIN = (47.0, 8.0, 400.0)
AHEAD_S = 1_700_000_000.0
BOOTED_S, NOW_S = 40.0, 500.0
OWN = KeptTakeoff(2, FLEET.name, FLEET.formation_hash(), 3.0, AHEAD_S + BOOTED_S, AHEAD_S + NOW_S - 1.0)


class Vehicle:
    """The tracker of vehicle 2 with its file, on a clock of its own."""

    def __init__(self, folder: Path, ahead_s: float = AHEAD_S) -> None:
        self.tracker = VehicleTracker(ORIGIN, height_from_takeoff=True)
        path = takeoff_path(2, {"STATE_DIRECTORY": f"{folder}:/var/lib/other"})
        assert path == folder / "takeoff_2.json"
        self.path = path
        member = FLEET.member(2)
        assert member is not None
        vehicle = VehicleConfig(id=2, fleet="fleet.yaml", mavlink="udpin:127.0.0.1:14540", hover_thrust_norm=0.5)
        self.file = TakeoffFile(path, AgentConfig(vehicle, FLEET, member), self.tracker, lambda: ahead_s)

    def fly(self, at_s: float, armed: bool, up_m: float = 3.0) -> None:
        landed = LandedState.IN_AIR if armed else LandedState.ON_GROUND
        heartbeat, origin = HeartbeatSample(at_s, armed, AutopilotKind.PX4), OriginSample(at_s, *ORIGIN)
        position = PositionSample(at_s, at_s - BOOTED_S, (0.0, 0.0, up_m), (0.0, 0.0, 0.0))
        self.tracker.fold([heartbeat, LandedSample(at_s, landed), origin, position])

    def work(self) -> bool:
        """Do what is due; whether something was."""
        due = self.file.due()
        if due:
            due()
        return due is not None


def kept(folder: Path, content: object) -> Vehicle:
    """A vehicle whose file has this content: bytes, or a record."""
    vehicle = Vehicle(folder)
    vehicle.path.write_bytes(content if isinstance(content, bytes) else msgspec.json.encode(content))
    return vehicle


def test_it_is_written_when_armed_now_and_then_and_removed_when_disarmed(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path)
    assert not vehicle.work()  # before the first HEARTBEAT nothing is known
    vehicle.fly(400.0, armed=False)
    vehicle.work()
    vehicle.fly(401.0, armed=True, up_m=4.0)
    assert vehicle.work()
    assert msgspec.json.decode(vehicle.path.read_bytes(), type=KeptTakeoff) == replace(OWN, seen_unix_s=AHEAD_S + 401.0)
    vehicle.fly(402.0, armed=True, up_m=5.0)
    assert not vehicle.work()
    vehicle.fly(401.0 + KEPT_EVERY_S, armed=True, up_m=5.0)
    assert vehicle.work()
    assert [path.name for path in tmp_path.iterdir()] == ["takeoff_2.json"]
    vehicle.fly(500.0, armed=False)
    assert vehicle.work()
    assert not vehicle.path.exists()
    assert not vehicle.work()


def test_an_agent_that_starts_in_the_air_reads_what_the_one_before_wrote(tmp_path: Path) -> None:
    before, after = Vehicle(tmp_path), Vehicle(tmp_path, ahead_s=AHEAD_S + 100.0)  # another monotonic clock
    before.fly(499.0, armed=False)
    before.fly(500.0, armed=True, up_m=8.0)
    before.work()
    assert not after.work()  # it removes nothing before it knows its autopilot
    ground = after.file.read(400.5)
    assert ground == GroundSample(400.5, 3.0, BOOTED_S - 100.0, pytest.approx(2.015))
    after.tracker.fold([ground])
    after.fly(401.0, armed=True, up_m=8.0)  # its autopilot has started 100 s later
    assert after.tracker.state.ground_unknown


def test_a_start_of_the_autopilot_after_the_writing_is_never_that_of_before(tmp_path: Path) -> None:
    """The autopilot had started half a second before: what else agrees to within seconds says nothing then."""
    vehicle = kept(tmp_path, replace(OWN, booted_unix_s=OWN.seen_unix_s - 0.5))
    ground = vehicle.file.read(NOW_S)
    assert ground
    assert ground.within_s == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is not what an agent keeps of a take-off: input data was truncated"),
        (b"\xff\xfe\x00", "is not what an agent keeps of a take-off"),
        (b"[" * 4000, "is not what an agent keeps of a take-off"),
        (b"{}" + b" " * 5000, "is not what an agent keeps of a take-off: larger than 4 kB"),
        (msgspec.json.encode(OWN)[:-9], "is not what an agent keeps of a take-off"),
        (msgspec.json.encode(OWN).replace(b"3.0", b"1e999"), "is not what an agent keeps of a take-off"),
        (msgspec.json.encode(OWN).replace(b"3.0", b'"3"'), "expected a number, got text - at $.ground_up_m"),
        (replace(OWN, ground_up_m=1e9), "at $.ground_up_m"),
        (replace(OWN, vehicle_id=3), 'is of vehicle 3 of fleet "pair"; expected 2 of "pair"'),
        (replace(OWN, fleet="other"), 'is of vehicle 2 of fleet "other"'),
        (replace(OWN, formation_hash=1), "was written with another fleet file"),
        (
            replace(OWN, seen_unix_s=AHEAD_S + NOW_S - 121.0),
            "was written 121 s ago by the clock; expected at most 120 s",
        ),
        (replace(OWN, seen_unix_s=AHEAD_S + NOW_S + 60.0), "was written -60 s ago by the clock"),
    ],
)
def test_what_is_broken_foreign_or_old_is_ignored_with_one_line(
    content: object, words: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    with caplog.at_level(logging.WARNING):
        assert kept(tmp_path, content).file.read(NOW_S) is None
    (line,) = caplog.messages
    assert line.startswith(f"{tmp_path}/takeoff_2.json: ")
    assert line.endswith("; ignored")
    assert words in line
    assert "\n" not in line


def test_without_a_file_there_is_nothing_to_say(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    assert Vehicle(tmp_path).file.read(NOW_S) is None
    assert caplog.messages == []
    assert takeoff_path(2, {}) is None


def test_a_folder_or_pipe_in_its_place_is_ignored(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    vehicle = Vehicle(tmp_path)
    vehicle.path.mkdir()
    assert vehicle.file.read(NOW_S) is None
    vehicle.path.rmdir()
    os.mkfifo(vehicle.path)
    assert vehicle.file.read(NOW_S) is None
    assert [line.count("ignored") for line in caplog.messages] == [1, 1]


def test_a_disk_that_takes_nothing_is_named_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    vehicle = Vehicle(tmp_path / "missing")
    vehicle.fly(400.0, armed=False)
    for at_s in (401.0, 420.0, 440.0):
        vehicle.fly(at_s, armed=True)
        assert vehicle.work()
    (line,) = caplog.messages
    assert line.endswith("No such file or directory; after a start in the air this vehicle must land")
