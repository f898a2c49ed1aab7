"""Starts real `sitl autopilot` processes on free ports, reads where they truly were, and ends them."""

from __future__ import annotations

import csv
import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from agent_process import until

from sitl.ports import Ports, ports_of

OFFSETS = range(640, 900, 4)


@dataclass(frozen=True)
class Truth:
    """One row of the truth file."""

    z_m: float
    roll_rad: float
    armed: bool
    mode: str


@dataclass
class StandInProcess:
    """A stand-in under test; what it says goes to `log_file`."""

    process: subprocess.Popen[bytes]
    ports: Ports
    log_file: Path
    truth_file: Path

    @property
    def log(self) -> str:
        return self.log_file.read_text(encoding="utf-8")

    def truth(self) -> list[Truth]:
        """The whole lines written so far, one for every 20 ms."""
        lines = self.truth_file.read_text(encoding="ascii").splitlines(keepends=True)
        rows = csv.DictReader(line for line in lines if line.endswith("\n"))
        return [Truth(float(r["z_m"]), float(r["roll_rad"]), r["armed"] == "1", r["mode"]) for r in rows]

    def wait_for_mode(self, mode: str) -> None:
        until(lambda: (rows := self.truth()) and rows[-1].mode == mode, 30.0)

    def wait_until_disarmed(self) -> None:
        until(lambda: not self.truth()[-1].armed, 30.0)


def free_offset() -> int:
    """A port offset at which all of vehicle 1's ports are free, away from simulated fleets.

    Two test runs at once begin to look in different places.
    """
    first = os.getpid() % len(OFFSETS)
    for offset in (*OFFSETS[first:], *OFFSETS[:first]):
        ports = ports_of(1, offset)
        try:
            for port in (ports.onboard, ports.companion, ports.ground_link):
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                    probe.bind(("127.0.0.1", port))
            with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(("127.0.0.1", ports.tcp))
        except OSError:
            continue
        return offset
    raise AssertionError("no free ports")


@contextmanager
def stand_in(folder: Path, configuration: str = "id: 1\n", *options: str) -> Iterator[StandInProcess]:
    """A running `sitl autopilot`, killed at the end if it still runs."""
    file, log_file, truth_file = folder / "autopilot.yaml", folder / "stand_in.log", folder / "truth.csv"
    file.write_text(configuration, encoding="utf-8")
    offset = free_offset()
    command = [sys.executable, "-m", "sitl", "autopilot", "--config", str(file), "--port-offset", str(offset)]
    with log_file.open("wb") as log:
        process = subprocess.Popen([*command, "--truth", str(truth_file), *options], stdout=log, stderr=log)
    try:
        until(lambda: log_file.stat().st_size > 0)
        yield StandInProcess(process, ports_of(1, offset), log_file, truth_file)
    finally:
        process.kill()
        process.wait()
