"""Starts real `companion` processes with their own files, and ends them."""

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

from own_ports import free_port

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


def until(condition: Callable[[], object], timeout_s: float = 20.0) -> None:
    end_s = time.monotonic() + timeout_s
    while not condition():
        assert time.monotonic() < end_s, f"condition not met within {timeout_s} s"
        time.sleep(0.01)
