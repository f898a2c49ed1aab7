"""Real processes of the project on ports of their own: agents, stand-ins, any command, and a service manager."""

from __future__ import annotations

import csv
import fcntl
import os
import signal
import socket
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import BinaryIO

from common import until
from sitl.links.ports import LOOPBACK, Ports, ports_of
from sitl.vehicle.truth import TRUTH_HEADER

PortOfKind = tuple[socket.SocketKind, int]

SINGLE_PORTS = range(22_000, 32_000)  # above the ports of fleets, below those that the kernel gives to connections
SINGLE_VEHICLES = range(640, 900, 4)
FLEETS = range(1000, 3400, 10)
LARGEST_FLEET = 5
TCP_LOCKS_BEGIN = 65_536  # byte of the lock file: port for UDP, this and the port for TCP


def free_port(kind: socket.SocketKind) -> int:
    """A port of its own for each call."""
    for port in _single_ports():
        if _take([(kind, port)]):
            return port
    raise AssertionError(f"no free port up to {SINGLE_PORTS.stop - 1}")


def free_fleet_offset() -> int:
    """For a fleet of up to LARGEST_FLEET vehicles of either make. The next call may return the same, once they have ended."""
    return _free_offset(FLEETS, LARGEST_FLEET)


def free_vehicle_offset() -> int:
    """For vehicle 1 alone. The next call may return the same, once its process has ended."""
    return _free_offset(SINGLE_VEHICLES, 1)


@cache
def _single_ports() -> Iterator[int]:
    return iter(SINGLE_PORTS)


def _free_offset(offsets: Iterable[int], vehicles: int) -> int:
    for offset in offsets:
        if _take([port for vehicle_id in range(1, vehicles + 1) for port in _of_vehicle(vehicle_id, offset)]):
            return offset
    raise AssertionError("no free ports")


def _of_vehicle(vehicle_id: int, offset: int) -> list[PortOfKind]:
    ports = ports_of(vehicle_id, offset)
    udp = [(socket.SOCK_DGRAM, port) for port in (ports.onboard, ports.companion, ports.ground_link, ports.zenoh)]
    return udp + [(socket.SOCK_STREAM, port) for port in (ports.tcp, ports.zenoh)]


def _take(ports: Iterable[PortOfKind]) -> bool:
    """Lock them all for this process, if all are free."""
    return all(_is_free(kind, port) and _lock(kind, port) for kind, port in ports)


def _is_free(kind: socket.SocketKind, port: int) -> bool:
    with socket.socket(socket.AF_INET, kind) as probe:
        if kind is socket.SOCK_STREAM:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)  # closed connections of the last test linger
        try:
            probe.bind((LOOPBACK, port))
        except OSError:
            return False
    return True


def _lock(kind: socket.SocketKind, port: int) -> bool:
    try:
        fcntl.lockf(
            _lock_file(),
            fcntl.LOCK_EX | fcntl.LOCK_NB,
            1,
            port + (TCP_LOCKS_BEGIN if kind is socket.SOCK_STREAM else 0),
        )
    except OSError:
        return False
    return True


@cache  # open until the process ends: closing it would release the locks
def _lock_file() -> BinaryIO:
    path = Path(tempfile.gettempdir()) / f"test-ports-{os.getuid()}.lock"
    path.touch(mode=0o600)
    return path.open("r+b")


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`python -m ARGUMENTS`, interrupted at the end. No COMPANION variable of this shell chooses its fleet."""
    command = [sys.executable, "-m", *arguments]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COMPANION")}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=40.0)
        finally:
            process.kill()


FLEET = """\
name: processtest
origin: {latitude_deg: 47.397742, longitude_deg: 8.545594, altitude_amsl_m: 488.0}
vehicles:
  - {id: 1, role: leader, slot_enu_m: [0.0, 0.0, 0.0]}
  - {id: 2, role: follower, slot_enu_m: [-1.5, 0.0, 0.0]}
neighbours: {kind: edges, edges: [[1, 2]]}
"""
VEHICLE = """\
id: 1
fleet: fleet.yaml
mavlink: {mavlink}
hover_thrust_norm: 0.49
zenoh: {{listen: ["{zenoh}"]}}
reference: {{kind: point, point_enu_m: [0.0, 0.0, 2.0]}}
"""


@dataclass(frozen=True)
class AgentFiles:
    """A vehicle file with its fleet file, and the ports in it."""

    file: Path
    udp_port: int
    zenoh: str


def agent_files(folder: Path, mavlink: str = "", zenoh: str = "") -> AgentFiles:
    """The files of vehicle 1, on free ports."""
    udp_port = free_port(socket.SOCK_DGRAM)
    zenoh = zenoh or f"tcp/127.0.0.1:{free_port(socket.SOCK_STREAM)}"
    (folder / "fleet.yaml").write_text(FLEET, encoding="utf-8")
    file = folder / "vehicle-1.yaml"
    file.write_text(VEHICLE.format(mavlink=mavlink or f"udpin:127.0.0.1:{udp_port}", zenoh=zenoh), encoding="utf-8")
    return AgentFiles(file, udp_port, zenoh)


@dataclass
class Running:
    """A process under test; its standard error goes to a file."""

    process: subprocess.Popen[bytes]
    log_file: Path

    @property
    def log(self) -> str:
        return self.log_file.read_text(encoding="utf-8")

    def wait_for_log(self, text: str, timeout_s: float = 20.0) -> None:
        until(lambda: text in self.log or self.process.poll() is not None, timeout_s)
        assert text in self.log, self.log

    def stop(self, number: int = signal.SIGTERM, timeout_s: float = 20.0) -> int:
        """Send a signal and wait for the end. Returns the exit code."""
        self.process.send_signal(number)
        return self.process.wait(timeout_s)


FAULTY_AGENT = """\
import sys
from pathlib import Path

from companion.cli.main import main
from {module} import {owner}

works = {owner}.{method}

def fails(self, *arguments, **named):
    if Path({switch!r}).exists():
        raise ZeroDivisionError("injected into {owner}.{method}")
    return works(self, *arguments, **named)

{owner}.{method} = fails
sys.exit(main(sys.argv[1:]))
"""


@contextmanager
def faulty_agent(files: AgentFiles, stage: Callable[..., object], switch: Path) -> Iterator[Running]:
    """A running `companion agent` whose `stage`, a method, raises from the moment on at which the file `switch` exists."""
    owner, method = stage.__qualname__.split(".")
    program = FAULTY_AGENT.format(module=stage.__module__, owner=owner, method=method, switch=str(switch))
    with _running(files, [sys.executable, "-c", program]) as running:
        yield running


@contextmanager
def agent(files: AgentFiles, *options: str, environment: Mapping[str, str] | None = None) -> Iterator[Running]:
    """A running `companion agent`, killed at the end if it still runs."""
    with _running(files, [sys.executable, "-m", "companion"], *options, environment=environment) as running:
        yield running


@contextmanager
def _running(
    files: AgentFiles, program: list[str], *options: str, environment: Mapping[str, str] | None = None
) -> Iterator[Running]:
    log_file = files.file.with_suffix(".log")
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            [*program, "agent", "--config", str(files.file), *options],
            stderr=log,
            env={**os.environ, **(environment or {})},
        )
    try:
        yield Running(process, log_file)
    finally:
        process.kill()
        process.wait()


def companion(*arguments: str, timeout_s: float = 30.0) -> subprocess.CompletedProcess[str]:
    """Run `companion` to its end."""
    return subprocess.run(
        [sys.executable, "-m", "companion", *arguments], capture_output=True, text=True, timeout=timeout_s, check=False
    )


TAIL_BYTES = 512  # of a truth file: more than two rows


@dataclass(frozen=True)
class Truth:
    """One row of the truth file."""

    z_m: float
    roll_rad: float
    armed: bool
    mode: str

    @classmethod
    def of(cls, row: Mapping[str, str]) -> Truth:
        """The row by its columns."""
        return cls(float(row["z_m"]), float(row["roll_rad"]), row["armed"] == "1", row["mode"])


@dataclass
class StandInProcess:
    """A stand-in under test; its output goes to `log_file`."""

    process: subprocess.Popen[bytes]
    ports: Ports
    log_file: Path
    truth_file: Path

    @property
    def log(self) -> str:
        return self.log_file.read_text(encoding="utf-8")

    def truth(self) -> list[Truth]:
        """The complete rows written so far, one every 20 ms."""
        lines = self.truth_file.read_text(encoding="ascii").splitlines(keepends=True)
        rows = csv.DictReader(line for line in lines if line.endswith("\n"))
        return [Truth.of(row) for row in rows]

    @property
    def newest(self) -> Truth | None:
        """The last complete row, None before the first. For polling: to parse all rows each time takes most of a core."""
        with self.truth_file.open("rb") as file:
            file.seek(-min(TAIL_BYTES, file.seek(0, os.SEEK_END)), os.SEEK_END)
            header, complete = TRUTH_HEADER.strip(), file.read().decode("ascii").split("\n")[:-1]
        if not complete or complete[-1] == header:
            return None
        return Truth.of(dict(zip(header.split(","), complete[-1].split(","), strict=True)))

    def first_truth(self) -> Truth:
        """The first row, which a starved process writes late."""
        until(lambda: self.newest, 30.0)
        return self.truth()[0]

    def wait_for_mode(self, mode: str) -> None:
        until(lambda: (row := self.newest) and row.mode == mode, 30.0)

    def wait_until_disarmed(self) -> None:
        until(lambda: (row := self.newest) and not row.armed, 30.0)


@contextmanager
def stand_in(folder: Path, configuration: str = "id: 1\n", *options: str) -> Iterator[StandInProcess]:
    """A running `sitl autopilot`, killed at the end if it still runs."""
    file, log_file, truth_file = folder / "autopilot.yaml", folder / "stand_in.log", folder / "truth.csv"
    file.write_text(configuration, encoding="utf-8")
    offset = free_vehicle_offset()
    command = [sys.executable, "-m", "sitl", "autopilot", "--config", str(file), "--port-offset", str(offset)]
    with log_file.open("wb") as log:
        process = subprocess.Popen([*command, "--truth", str(truth_file), *options], stdout=log, stderr=log)
    try:
        until(lambda: log_file.stat().st_size > 0)
        yield StandInProcess(process, ports_of(1, offset), log_file, truth_file)
    finally:
        process.kill()
        process.wait()


WATCHDOG_S = 1.0


class ServiceManager:
    """Listens on the socket of NOTIFY_SOCKET."""

    def __init__(self, address: str) -> None:
        self.address = address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.setblocking(False)
        self.messages: list[str] = []

    def listen(self) -> list[str]:
        """All messages received so far."""
        while True:
            try:
                self.messages.append(self._socket.recv(4096).decode())
            except BlockingIOError:
                return self.messages

    def forget(self) -> None:
        self.listen()
        self.messages.clear()

    def wait_for(self, message: str) -> None:
        until(lambda: message in self.listen())

    def environment(self) -> dict[str, str]:
        return {"NOTIFY_SOCKET": self.address, "WATCHDOG_USEC": str(int(WATCHDOG_S * 1e6)), "WATCHDOG_PID": ""}

    def close(self) -> None:
        self._socket.close()


@contextmanager
def service_manager(address: str) -> Iterator[ServiceManager]:
    manager = ServiceManager(address)
    try:
        yield manager
    finally:
        manager.close()
