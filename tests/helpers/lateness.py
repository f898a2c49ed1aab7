"""Measured lateness of the processes under test and of the test process, to distinguish a starved test from a failed one."""

from __future__ import annotations

import os
import re
import threading
import time
from dataclasses import dataclass
from pathlib import Path

STAT = Path("/proc/stat")
# Share of all processors that the hypervisor gives to other machines, within STOLEN_WITHIN_S. Idle machines show none.
STOLEN_SHARE = 0.1
STOLEN_WITHIN_S = 1.0
# One period of the control loop. On an idle machine no cycle starts more than 2 ms late.
# Cycles that start more than 20 ms late are logged (companion/link/tick.py).
STARVED_S = 0.02
PROBE_PERIOD_S = 0.01
REPORTED = re.compile(r"LOOP_LATE: \d+ cycles of the loop started late, at most (\d+) ms")


@dataclass(frozen=True)
class Late:
    """One measured lateness: who measured it and when it was collected, by the monotonic clock."""

    source: str
    late_s: float
    collected_s: float

    def __str__(self) -> str:
        return f"{self.source} {self.late_s * 1000:.0f} ms late"


class ReportedLateness:
    """Lateness that agents and stand-ins report in their logs: all `*.log` files below `folder`."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._read_bytes: dict[Path, int] = {}

    def collect(self) -> list[Late]:
        """What was reported since the last call."""
        now_s = time.monotonic()
        return [late for file in self._folder.rglob("*.log") for late in self._new(file, now_s)]

    def _new(self, file: Path, now_s: float) -> list[Late]:
        try:
            with file.open("rb") as log:
                begin = self._read_bytes.get(file, 0)
                log.seek(begin if begin <= log.seek(0, os.SEEK_END) else 0)
                lines, newline, unfinished = log.read().rpartition(b"\n")
                self._read_bytes[file] = log.tell() - len(unfinished)
        except OSError:  # removed meanwhile, or a folder
            return []
        found = REPORTED.findall((lines + newline).decode(errors="replace"))
        return [Late(file.stem, int(ms) / 1000.0, now_s) for ms in found]


class StolenTime:
    """Processor time that the hypervisor took from this machine: `steal` of /proc/stat. None of it is the work of the tests."""

    def __init__(self) -> None:
        self._sampled_s = time.monotonic()
        self._stolen, self._total = _processor_times()
        self._worst = 0.0

    def sample(self) -> None:
        """Call often; takes a sample every STOLEN_WITHIN_S."""
        now_s = time.monotonic()
        if now_s - self._sampled_s < STOLEN_WITHIN_S:
            return
        stolen, total = _processor_times()
        if total > self._total:
            self._worst = max(self._worst, (stolen - self._stolen) / (total - self._total))
        self._sampled_s, self._stolen, self._total = now_s, stolen, total

    def collect(self) -> float:
        """The largest share within STOLEN_WITHIN_S since the last call, 0 to 1."""
        worst, self._worst = self._worst, 0.0
        return worst


def _processor_times() -> tuple[int, int]:
    """Stolen and total time of all processors, in ticks of the kernel; zeros where the kernel reports none."""
    try:
        times = [int(number) for number in STAT.read_text().split("\n", 1)[0].split()[1:9]]
    except OSError:
        return 0, 0
    return times[7], sum(times)


class OwnLateness(threading.Thread):
    """Lateness of a thread of the test process that wakes every PROBE_PERIOD_S, and what the hypervisor took meanwhile.

    The time in which the process itself ran is not counted. For tests whose processes report no lateness, or do not run yet.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True, name="lateness")
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._worst_s = 0.0
        self._stolen = StolenTime()

    def run(self) -> None:
        while not self._ended.is_set():
            began_s, ran_s = time.monotonic(), time.process_time()
            self._ended.wait(PROBE_PERIOD_S)
            late_s = time.monotonic() - began_s - PROBE_PERIOD_S - (time.process_time() - ran_s)
            with self._lock:
                self._worst_s = max(self._worst_s, late_s)
                self._stolen.sample()

    def collect(self) -> list[Late]:
        """The worst since the last call."""
        with self._lock:
            worst_s, self._worst_s = self._worst_s, 0.0
        return [Late("test process", worst_s, time.monotonic())]

    def collect_stolen(self) -> float:
        """The largest share of the processors that was stolen since the last call."""
        with self._lock:
            return self._stolen.collect()

    def end(self) -> None:
        self._ended.set()
        self.join()
