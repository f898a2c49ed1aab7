"""`sitl fly` interrupted, killed and robbed of its processes: what flies lands, nothing is left, one line says why."""

import os
import signal
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from sitl.ports import ports_of
from sitl.summary import read_summary

PLATOON = Path(__file__).parents[2] / "config" / "scenarios" / "platoon.yaml"
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
    """A `sitl fly` in the background, and all the processes that come from it."""

    def __init__(self, folder: Path, port_offset: int) -> None:
        self.folder = folder / "out"
        self.marker = uuid.uuid4().hex
        self._log = folder / "fly.log"
        overrides = [word for key in ("timeline[2].for_s=0", "timeline[3].for_s=120") for word in ("--set", key)]
        arguments = [str(PLATOON), "--out", str(self.folder), "--port-offset", str(port_offset), *overrides]
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

    def agents_say(self, words: str) -> bool:
        logs = [self.folder / f"agent_{vehicle_id}.log" for vehicle_id in (1, 2, 3, 4)]
        return all(log.exists() and words in log.read_text(encoding="utf-8") for log in logs)

    def wait_for_formation(self) -> None:
        self.wait_until(lambda: self.agents_say("engage -> formation") or self.process.poll() is not None, 60.0)
        assert self.process.poll() is None, self.printed
        time.sleep(1.0)

    def wait_until(self, true: Callable[[], bool], within_s: float) -> None:
        deadline_s = time.monotonic() + within_s
        while not true():
            assert time.monotonic() < deadline_s, self.printed
            time.sleep(0.1)

    def end(self, within_s: float) -> int:
        """The exit code."""
        return self.process.wait(within_s)

    def process_of(self, role: str, vehicle_id: int) -> int:
        file = f"{'vehicle' if role == 'agent' else role}_{vehicle_id}.yaml"
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
def launch(tmp_path: Path) -> Iterator[Callable[[int], Flight]]:
    flights: list[Flight] = []

    def start(port_offset: int) -> Flight:
        flights.append(Flight(tmp_path, port_offset))
        return flights[-1]

    yield start
    for flight in flights:
        flight.clean_up()


@fleet
def test_ctrl_c_in_formation_lands_everything_and_leaves_nothing(launch: Callable[[int], Flight]) -> None:
    flight = launch(2100)
    flight.wait_for_formation()
    assert len(processes(flight.marker)) == 9
    flight.process.send_signal(signal.SIGINT)
    assert flight.end(40.0) == 130
    assert processes(flight.marker) == {}
    assert not any(flight.armed_at_the_end(vehicle_id) for vehicle_id in (1, 2, 3, 4))
    assert flight.agents_say("land -> observe")
    summary = read_summary(flight.folder / "summary.json")
    assert summary.failure == "interrupted by SIGINT"
    assert summary.duration_s is not None
    assert "Traceback" not in flight.printed


@fleet
def test_a_second_ctrl_c_stops_at_once(launch: Callable[[int], Flight]) -> None:
    flight = launch(2110)
    flight.wait_for_formation()
    flight.process.send_signal(signal.SIGINT)
    time.sleep(0.5)
    flight.process.send_signal(signal.SIGINT)
    assert flight.end(2.0) == 130
    assert processes(flight.marker) == {}
    assert flight.printed.splitlines()[-1] == "stopped at once; nothing was landed"


@fleet
def test_sigterm_on_the_ground_stops_everything(launch: Callable[[int], Flight]) -> None:
    flight = launch(2120)
    flight.wait_until(lambda: flight.agents_say("observe -> prepare"), 30.0)
    flight.process.send_signal(signal.SIGTERM)
    assert flight.end(20.0) == 143
    assert processes(flight.marker) == {}
    assert not any(flight.armed_at_the_end(vehicle_id) for vehicle_id in (1, 2, 3, 4))


@fleet
def test_killing_the_parent_leaves_nothing(launch: Callable[[int], Flight]) -> None:
    flight = launch(2130)
    flight.wait_for_formation()
    flight.process.kill()
    flight.end(5.0)
    flight.wait_until(lambda: not processes(flight.marker), 10.0)


@fleet
@pytest.mark.parametrize(("role", "vehicle_id", "port_offset"), [("agent", 3, 2140), ("autopilot", 2, 2150)])
def test_a_process_that_dies_in_formation_ends_the_flight_and_the_others_land(
    launch: Callable[[int], Flight], role: str, vehicle_id: int, port_offset: int
) -> None:
    flight = launch(port_offset)
    flight.wait_for_formation()
    os.kill(flight.process_of(role, vehicle_id), signal.SIGKILL)
    flight.wait_until(lambda: "landing all" in flight.printed, 1.5)
    assert flight.end(40.0) == 1
    assert processes(flight.marker) == {}
    others = {1, 2, 3, 4} - {vehicle_id}
    assert not any(flight.armed_at_the_end(other) for other in others)
    failure = read_summary(flight.folder / "summary.json").failure
    assert failure is not None
    assert failure.startswith(f"{role} {vehicle_id} was killed by SIGKILL: ")
    assert failure in flight.printed
    assert "Traceback" not in flight.printed


# ---------------------------------------------------------------- what is found before anything is started


def refused(*arguments: str) -> str:
    """The one line of a `sitl fly` that does not start anything."""
    done = subprocess.run(
        [sys.executable, "-m", "sitl", "fly", *arguments], capture_output=True, text=True, timeout=30, check=False
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    return done.stderr.strip()


@pytest.mark.parametrize(
    ("kind", "port", "words"),
    [
        (socket.SOCK_DGRAM, ports_of(2, 2200).onboard, "wanted by autopilot 2 towards its agent"),
        (socket.SOCK_DGRAM, ports_of(1, 2200).companion, "wanted by agent 1 towards its autopilot"),
        (socket.SOCK_DGRAM, ports_of(4, 2200).ground_link, "wanted by autopilot 4 towards a ground station"),
        (socket.SOCK_STREAM, ports_of(3, 2200).zenoh, "wanted by Zenoh of agent 3"),
    ],
)
def test_a_port_in_use_is_found_first(tmp_path: Path, kind: socket.SocketKind, port: int, words: str) -> None:
    with socket.socket(socket.AF_INET, kind) as other:
        other.bind(("127.0.0.1", port))
        if kind is socket.SOCK_STREAM:
            other.listen()
        line = refused(str(PLATOON), "--out", str(tmp_path / "out"), "--port-offset", "2200")
    assert line.startswith(f"{'UDP' if kind is socket.SOCK_DGRAM else 'TCP'} port {port}, {words}")
    assert "--port-offset 2300" in line
    assert not (tmp_path / "out").exists()


def test_a_bad_scenario_and_a_bad_override_are_one_line(tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text(PLATOON.read_text(encoding="utf-8").replace("role: leader", "role: follower"), encoding="utf-8")
    assert refused(str(bad)).startswith(f"{bad}: fleet.vehicles: no vehicle leads")
    assert refused(str(tmp_path / "none.yaml")).endswith("cannot be read: No such file or directory; check the path")
    assert (
        refused(str(PLATOON), "--set", "fleet.law.nam=x") == '--set: fleet.law.nam: unknown key; did you mean "name"?'
    )


def test_a_comparison_without_a_formation_is_refused() -> None:
    line = refused(str(PLATOON), "--compare", "--set", "timeline=[{command: prepare}]")
    assert "timeline: has no step with command: form" in line


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.touch()
    assert refused(str(PLATOON), "--port-offset", "2250", "--out", str(file)) == (
        f"{file}: File exists; choose another folder with --out"
    )
