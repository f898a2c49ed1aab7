"""Starts real `sitl autopilot` processes on free ports, reads their truth files, and ends them."""

from __future__ import annotations

import csv
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from agent_process import until
from own_ports import free_vehicle_offset
from sitl.links.ports import Ports, ports_of
from sitl.vehicle.truth import TRUTH_HEADER

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
