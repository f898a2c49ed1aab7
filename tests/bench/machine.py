"""The machine of a measurement: what it is, and what others took of it meanwhile."""

from __future__ import annotations

import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

from msgspec import Struct

TICKS_A_SECOND = os.sysconf("SC_CLK_TCK")
STOLEN = 7  # column of /proc/stat
PARENT, TIMES = 1, slice(11, 15)  # columns of /proc/PID/stat after the name: user, system, and those of ended children


class Machine(Struct, frozen=True, kw_only=True):
    """Where and when the run took place. `stolen_percent`: of the cores' time, taken by the hypervisor."""

    processor: str
    cores: int
    python: str
    commit: str
    date: str
    lasted_s: float
    stolen_percent: float

    def in_words(self) -> str:
        return (
            f"Measured on {self.date} in {self.lasted_s / 60.0:.1f} minutes on {self.cores} cores of {self.processor},"
            f" Python {self.python}, commit {self.commit}. The hypervisor took {self.stolen_percent:.1f} % of the cores."
        )


class Times(Struct, frozen=True):
    """Of all cores since the start of the machine, in clock ticks."""

    all: int
    stolen: int


def times_of(stat: str) -> Times:
    """From the text of /proc/stat."""
    columns = [int(column) for column in stat.split("\n", 1)[0].split()[1:9]]
    return Times(sum(columns), columns[STOLEN])


def times() -> Times:
    return times_of(Path("/proc/stat").read_text(encoding="ascii"))


def stolen_percent(before: Times, after: Times) -> float:
    """Share of the cores' time that the hypervisor took."""
    return 100.0 * (after.stolen - before.stolen) / max(1, after.all - before.all)


def others_cpu_s() -> float:
    """CPU time up to now of all processes but this one and those that it started, seconds.

    What ended in between counts with its parent. /proc/stat less the own time would count interrupts too, by samples.
    """
    processes = {}
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            columns = file.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
        except OSError:  # it has just ended
            continue
        processes[int(file.parent.name)] = (int(columns[PARENT]), sum(map(int, columns[TIMES])))
    return used_by_others(os.getpid(), processes) / TICKS_A_SECOND


def used_by_others(own_id: int, processes: Mapping[int, tuple[int, int]]) -> int:
    """Sum over all processes that this one did not start. `processes`: parent and use of each."""

    def is_own(process_id: int) -> bool:
        while process_id != own_id:
            if process_id not in processes:
                return False
            process_id, _ = processes[process_id]
        return True

    return sum(used for process_id, (_, used) in processes.items() if not is_own(process_id))


def this_machine(lasted_s: float, stolen: float) -> Machine:
    """Of a measurement that ends now. `stolen`: percent of the cores' time, taken by the hypervisor."""
    return Machine(
        processor=_processor(),
        cores=len(os.sched_getaffinity(0)),
        python=platform.python_version(),
        commit=_commit(),
        date=f"{datetime.now(UTC):%Y-%m-%d}",
        lasted_s=lasted_s,
        stolen_percent=stolen,
    )


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _commit() -> str:
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
