"""Starts real `companion` processes with files of their own, and ends them."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

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

PORTS_OF_A_RUN, RUNS_AT_ONCE = 100, 50


def free_port(first: int, kind: int) -> int:
    """The first free port from `first` on, from a range of this process: two test runs at once take different ones."""
    first += PORTS_OF_A_RUN * (os.getpid() % RUNS_AT_ONCE)
    for port in range(first, first + PORTS_OF_A_RUN):
        with socket.socket(socket.AF_INET, kind) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError:
                continue
            return port
    raise AssertionError(f"no free port from {first} on")


@dataclass(frozen=True)
class AgentFiles:
    """A vehicle file with its fleet file, and the ports in it."""

    file: Path
    udp_port: int
    zenoh: str


def agent_files(folder: Path, mavlink: str = "", zenoh: str = "") -> AgentFiles:
    """Vehicle 1's files, on free ports away from a simulated fleet's."""
    udp_port = free_port(24540, socket.SOCK_DGRAM)
    zenoh = zenoh or f"tcp/127.0.0.1:{free_port(17700, socket.SOCK_STREAM)}"
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

    def wait_for_log(self, words: str, timeout_s: float = 20.0) -> None:
        until(lambda: words in self.log or self.process.poll() is not None, timeout_s)
        assert words in self.log, self.log

    def stop(self, number: int = signal.SIGTERM, timeout_s: float = 20.0) -> int:
        """Send a signal and wait for the end; the exit code."""
        self.process.send_signal(number)
        return self.process.wait(timeout_s)


@contextmanager
def agent(files: AgentFiles, *options: str, environment: Mapping[str, str] | None = None) -> Iterator[Running]:
    """A running `companion agent`, killed at the end if it still runs."""
    log_file = files.file.with_suffix(".log")
    with log_file.open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", "companion", "agent", "--config", str(files.file), *options],
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


def until(condition: Callable[[], object], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, "it never came true"
        time.sleep(0.01)
