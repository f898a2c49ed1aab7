"""The machine of a measurement: what it is, how long it took, and what others took of it meanwhile."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
import sysconfig
import time
from datetime import UTC, datetime
from pathlib import Path

from msgspec import Struct

from tests.bench.processes import core_time, others_cpu_s, stolen_percent


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


class Meanwhile:
    """Begins with a measurement; both methods describe the time since then."""

    def __init__(self) -> None:
        self._core_time, self._others_s, self._began_s = core_time(), others_cpu_s(), time.monotonic()

    @property
    def lasted_s(self) -> float:
        return time.monotonic() - self._began_s

    def others_cores(self) -> float:
        """What processes outside of the measurement used, in cores."""
        return (others_cpu_s() - self._others_s) / self.lasted_s

    def machine(self) -> Machine:
        return Machine(
            processor=_processor(),
            cores=len(os.sched_getaffinity(0)),
            python=python_in_words(),
            commit=_commit(),
            date=f"{datetime.now(UTC):%Y-%m-%d}",
            lasted_s=self.lasted_s,
            stolen_percent=stolen_percent(self._core_time, core_time()),
        )


def python_in_words() -> str:
    """Version and build. One without profile-guided optimisation takes up to 1.4 times the CPU time of the distribution's."""
    options = sysconfig.get_config_var("CONFIG_ARGS") or ""
    if sys.base_prefix == "/usr":
        build = "the distribution's build"
    elif "--enable-optimizations" in options:
        build = "built with --enable-optimizations"
    else:
        build = "built without optimisation"
    return f"{platform.python_version()} ({build})"


def _processor() -> str:
    lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _commit() -> str:
    command = ["git", "rev-parse", "--short", "HEAD"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
