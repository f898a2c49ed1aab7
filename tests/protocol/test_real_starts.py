"""`sitl fly --external px4` with programs that only look like PX4: whatever they do, one line says it and none is left."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from common import until
from companion.types.autopilot import AutopilotKind
from processes import free_fleet_offset
from sitl.flight import real_start
from sitl.flight.orders import FlightFailure
from sitl.flight.processes import FleetProcesses
from sitl.flight.real_autopilots import RealFleet
from sitl.flight.scenario import load_scenario
from sitl.report.metrics import read_track

MARKER = "REAL_START_MARKER"
SITL_FLY = (sys.executable, "-m", "sitl", "fly")
BINARY = """\
#!{python}
import os, pathlib, shutil, socket, struct, sys, time
print("px4 of the test", *sys.argv[1:], flush=True)
pathlib.Path("was_here").touch()
if os.environ["DOES"] == "ends":
    sys.exit("no airframe of this name")
if os.environ["DOES"] == "says nothing":
    time.sleep(120)
from companion.mavlink.codec import MavlinkCodec, mavlink
instance, port = int(sys.argv[2]), int(pathlib.Path(shutil.which("px4-rc.mavlink", os.F_OK)).read_text().split()[-1]) - 40
latitude, longitude, altitude = (float(os.environ["PX4_HOME_" + name]) for name in ("LAT", "LON", "ALT"))
state = struct.pack("<36xiii16x", round(latitude * 1e7), round(longitude * 1e7), round(altitude * 1e3))
codec, udp = MavlinkCodec(instance + 1, 1), socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
while True:
    hil = mavlink.mavlink_map[mavlink.MAVLINK_MSG_ID_HIL_STATE_QUATERNION](state)
    udp.sendto(codec.encode(hil), ("127.0.0.1", port))
    time.sleep(0.02)
"""
SCENARIO = """\
fleet:
  name: one
  origin: {latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}
  vehicles: [{id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}]
  neighbours: {kind: edges, edges: []}
starts_enu_m: {1: [3.0, 0.0, 0.0]}
reference: {kind: point, point_enu_m: [1.0, 0.0, 1.0]}
"""


def scenario_in(folder: Path) -> Path:
    """A scenario of one vehicle, and beside it the program."""
    binary, scenario, script = folder / "bin" / "px4", folder / "one.yaml", folder / "etc" / "init.d-posix" / "rcS"
    for path in (binary, script):
        path.parent.mkdir(parents=True)
    script.touch()
    binary.write_text(BINARY.format(python=sys.executable), encoding="utf-8")
    binary.chmod(0o755)
    scenario.write_text(SCENARIO, encoding="utf-8")
    return scenario


def left(marker: str) -> list[int]:
    """Processes that carry the marker, without zombies."""
    found = []
    for folder in Path("/proc").iterdir():
        try:
            carries = folder.name.isdecimal() and marker.encode() in (folder / "environ").read_bytes()
        except OSError:  # ended meanwhile, or another user's
            continue
        if carries:
            found.append(int(folder.name))
    return found


@dataclass
class Starts:
    """Starts of one real fleet in this process. Their processes carry `marker`."""

    folder: Path
    scenario: Path
    marker: str
    set_environment: Callable[[str, str], None]

    def begin(self, does: str, step: Callable[[str], None] = lambda _doing: time.sleep(0.02)) -> FleetProcesses:
        """Raises FlightFailure."""
        self.set_environment("DOES", does)
        self.folder.mkdir()
        program = self.scenario.parent / "bin" / "px4"
        fleet = RealFleet.of(load_scenario(self.scenario, ()), AutopilotKind.PX4, [program])
        return real_start.start_real(fleet, self.folder, free_fleet_offset(), step)

    def failure(self, does: str) -> str:
        """No process remains of a start that fails."""
        with pytest.raises(FlightFailure) as failed:
            self.begin(does)
        assert left(self.marker) == []
        return str(failed.value)


@pytest.fixture
def starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Starts:
    marker = uuid.uuid4().hex
    monkeypatch.setenv(MARKER, marker)
    return Starts(tmp_path / "out", scenario_in(tmp_path), marker, monkeypatch.setenv)


def test_an_autopilot_that_ends_at_once_is_named_with_its_last_line_and_its_log(starts: Starts) -> None:
    log = starts.folder / "autopilot_1.log"
    assert starts.failure("ends") == f"autopilot 1 ended with exit code 1: no airframe of this name; log: {log}"
    assert not (starts.folder / "agent_1.log").exists()


def test_an_autopilot_that_never_says_where_it_is_is_named_with_its_log(
    starts: Starts, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(real_start, "POSITION_WITHIN_S", 0.1)
    log = starts.folder / "autopilot_1.log"
    assert starts.failure("says nothing") == f"vehicle 1 sent no true position within 0.1 s of the start; log: {log}"


def test_an_autopilot_killed_on_the_ground_is_named_and_its_true_track_is_kept(starts: Starts) -> None:
    with starts.begin("flies") as processes:
        os.kill(processes.pid_of("autopilot 1"), signal.SIGKILL)
        log, endings = starts.folder / "autopilot_1.log", list[str | None]()
        until(lambda: endings.append(processes.unexpected_end()) or endings[-1] is not None, 10.0)
        assert endings[-1] == f"autopilot 1 was killed by SIGKILL; log: {log}"
    assert left(starts.marker) == []
    assert read_track(starts.folder / "truth_1.csv").position_enu_m[0] == pytest.approx([3.0, 0.0, 0.0], abs=0.01)


class RealFlight:
    """`sitl fly` of one vehicle in the background."""

    def __init__(self, folder: Path, does: str) -> None:
        self.folder, self.marker, scenario = folder / "out", uuid.uuid4().hex, str(scenario_in(folder))
        arguments = [scenario, "--external", "px4", "--binary", str(folder / "bin" / "px4"), "--quiet"]
        self.process = subprocess.Popen(
            [*SITL_FLY, *arguments, "--out", str(self.folder), "--port-offset", str(free_fleet_offset())],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            env={**os.environ, MARKER: self.marker, "DOES": does},
        )


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[[str], RealFlight]]:
    flights: list[RealFlight] = []

    def start(does: str) -> RealFlight:
        flights.append(RealFlight(tmp_path, does))
        return flights[-1]

    yield start
    for flight in flights:
        for pid in left(flight.marker):
            os.kill(pid, signal.SIGKILL)
        flight.process.wait()


def test_ctrl_c_while_they_start_ends_them(launch: Callable[[str], RealFlight]) -> None:
    flight = launch("says nothing")
    until((flight.folder / "autopilot_1" / "was_here").exists, 60.0)
    flight.process.send_signal(signal.SIGINT)
    printed, _ = flight.process.communicate(timeout=60)
    assert (flight.process.returncode, left(flight.marker)) == (130, [])
    assert "interrupted by SIGINT" in printed and "Traceback" not in printed


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux signals the end of the parent")
def test_a_killed_sitl_fly_leaves_no_process(launch: Callable[[str], RealFlight]) -> None:
    flight = launch("says nothing")
    until((flight.folder / "autopilot_1" / "was_here").exists, 60.0)
    assert len(left(flight.marker)) == 3  # sitl fly, true positions, autopilot
    flight.process.kill()
    until(lambda: left(flight.marker) == [], 10.0)
