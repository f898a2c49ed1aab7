"""`sitl fly` is interrupted or killed, or loses a process: the vehicles land, no process is left, one line says why."""

import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from processes import free_fleet_offset
from sitl.report.summary import read_summary

IDS = (1, 2)
SCENARIO = """\
fleet:
  name: pair
  origin: {latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}
  vehicles:
    - {id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}
    - {id: 2, role: follower, slot_enu_m: [-3.0, 0.0, 0.0]}
  neighbours: {kind: edges, edges: [[1, 2]]}
  takeoff_height_m: 1.0
starts_enu_m: {1: [0.0, 0.0, 0.0], 2: [-3.0, 0.0, 0.0]}
reference: {kind: point, point_enu_m: [1.0, 0.0, 1.0]}
stand_in: {sensors: ideal, armable_after_s: 1}
timeline: [{command: prepare}, {command: arm}, {command: takeoff}, {command: form, for_s: 120}, {command: land}]
"""
MARKER = "SITL_TEST_MARKER"
fleet = pytest.mark.fleet


def processes(marker: str) -> dict[int, str]:
    """Command lines of all processes that carry the marker in their environment, by process id."""
    found = {}
    for folder in Path("/proc").iterdir():
        if not folder.name.isdecimal():
            continue
        try:
            if f"{MARKER}={marker}".encode() in (folder / "environ").read_bytes().split(b"\0"):
                found[int(folder.name)] = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
        except OSError:  # ended meanwhile, or another user's
            continue
    return {pid: command for pid, command in found.items() if command}


class Flight:
    """A `sitl fly` in the background, and all processes that it started."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "out"
        self.marker = uuid.uuid4().hex
        self._log = folder / "fly.log"
        scenario = folder / "pair.yaml"
        scenario.write_text(SCENARIO, encoding="utf-8")
        arguments = [str(scenario), "--out", str(self.folder), "--port-offset", str(free_fleet_offset())]
        with self._log.open("w") as output:
            self.process = subprocess.Popen(
                [sys.executable, "-m", "sitl", "fly", *arguments],
                stdout=output,
                stderr=subprocess.STDOUT,
                env={**os.environ, MARKER: self.marker},
                start_new_session=True,
            )

    @property
    def printed(self) -> str:
        return self._log.read_text(encoding="utf-8")

    def agents_logged(self, text: str) -> bool:
        logs = [self.folder / f"agent_{vehicle_id}.log" for vehicle_id in IDS]
        return all(log.exists() and text in log.read_text(encoding="utf-8") for log in logs)

    def wait_for_formation(self) -> None:
        self.wait_until(lambda: self.agents_logged("engage -> formation") or self.process.poll() is not None, 60.0)
        assert self.process.poll() is None, self.printed
        time.sleep(1.0)

    def wait_until(self, condition: Callable[[], bool], within_s: float) -> None:
        deadline_s = time.monotonic() + within_s
        while not condition():
            assert time.monotonic() < deadline_s, self.printed
            time.sleep(0.1)

    def end(self, within_s: float) -> int:
        """The exit code."""
        return self.process.wait(within_s)

    def process_with(self, file: str) -> int:
        return next(pid for pid, command in processes(self.marker).items() if file in command)

    def armed_at_the_end(self, vehicle_id: int) -> bool:
        last = (self.folder / f"truth_{vehicle_id}.csv").read_text(encoding="utf-8").splitlines()[-1]
        return last.split(",")[-2] == "1"

    def clean_up(self) -> None:
        for pid in [self.process.pid, *processes(self.marker)]:
            try:
                os.kill(pid, signal.SIGKILL)
            except ProcessLookupError:
                continue
        self.process.wait()


@pytest.fixture
def launch(tmp_path: Path) -> Iterator[Callable[[], Flight]]:
    flights: list[Flight] = []

    def start() -> Flight:
        flights.append(Flight(tmp_path))
        return flights[-1]

    yield start
    for flight in flights:
        flight.clean_up()


@fleet
def test_ctrl_c_in_formation_lands_all_and_leaves_no_process(launch: Callable[[], Flight]) -> None:
    flight = launch()
    flight.wait_for_formation()
    assert len(processes(flight.marker)) == 4  # sitl fly, two agents, one process with both stand-ins
    flight.process.send_signal(signal.SIGINT)
    assert flight.end(40.0) == 130
    assert processes(flight.marker) == {}
    assert not any(flight.armed_at_the_end(vehicle_id) for vehicle_id in IDS)
    assert flight.agents_logged("land -> observe")
    summary = read_summary(flight.folder / "summary.json")
    assert summary.failure == "interrupted by SIGINT"
    assert summary.duration_s is not None
    assert "Traceback" not in flight.printed


@fleet
@pytest.mark.long
def test_a_second_ctrl_c_stops_at_once(launch: Callable[[], Flight]) -> None:
    flight = launch()
    flight.wait_for_formation()
    flight.process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    flight.process.send_signal(signal.SIGINT)
    assert flight.end(2.0) == 130
    assert processes(flight.marker) == {}
    assert flight.printed.splitlines()[-1] == "stopped at once; the vehicles were not landed"


@fleet
def test_sigterm_on_the_ground_stops_all_processes(launch: Callable[[], Flight]) -> None:
    flight = launch()
    flight.wait_until(lambda: flight.agents_logged("observe -> prepare"), 30.0)
    flight.process.send_signal(signal.SIGTERM)
    assert flight.end(20.0) == 143
    assert processes(flight.marker) == {}
    assert not any(flight.armed_at_the_end(vehicle_id) for vehicle_id in IDS)


def kill_the_parent(flight: Flight) -> None:
    flight.wait_for_formation()
    flight.process.kill()
    flight.end(5.0)
    flight.wait_until(lambda: not processes(flight.marker), 5.0)


@fleet
def test_killing_the_parent_leaves_no_process(launch: Callable[[], Flight]) -> None:
    kill_the_parent(launch())


@pytest.mark.long
@pytest.mark.parametrize("attempt", range(20))
def test_killing_the_parent_leaves_no_process_in_twenty_tries(launch: Callable[[], Flight], attempt: int) -> None:
    """Every other one beside a busy loop on each core."""
    cores = os.cpu_count() or 1
    loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(cores * (attempt % 2))]
    try:
        kill_the_parent(launch())
    finally:
        for loop in loops:
            loop.kill()
            loop.wait()


@fleet
def test_an_agent_killed_in_formation_ends_the_flight_and_the_others_land(launch: Callable[[], Flight]) -> None:
    flight = launch()
    flight.wait_for_formation()
    os.kill(flight.process_with("vehicle_2.yaml"), signal.SIGKILL)
    flight.wait_until(lambda: "landing all" in flight.printed, 1.5)
    assert flight.end(40.0) == 1
    assert processes(flight.marker) == {}
    assert not flight.armed_at_the_end(1)
    assert_failure(flight, "agent 2 was killed by SIGKILL; log: ")


@fleet
@pytest.mark.long
def test_stand_ins_killed_in_formation_end_the_flight(launch: Callable[[], Flight]) -> None:
    flight = launch()
    flight.wait_for_formation()
    os.kill(flight.process_with("autopilot_2.yaml"), signal.SIGKILL)
    assert flight.end(40.0) == 1
    assert processes(flight.marker) == {}
    assert_failure(flight, "autopilots 1 to 2 were killed by SIGKILL; log: ")


def assert_failure(flight: Flight, begins: str) -> None:
    """The summary and the output name it."""
    failure = read_summary(flight.folder / "summary.json").failure
    assert failure is not None
    assert failure.startswith(begins)
    assert failure in flight.printed
    assert "Traceback" not in flight.printed
