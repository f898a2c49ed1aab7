"""Measured lateness of the processes under test and of the test process, to distinguish a starved test from a failed one."""

from __future__ import annotations

import os
import re
import threading
import time
from dataclasses import dataclass
from pathlib import Path

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


class OwnLateness(threading.Thread):
    """Lateness of a thread of the test process that wakes every PROBE_PERIOD_S.

    The time in which the process itself ran is not counted. For tests whose processes report no lateness, or do not run yet.
    """

    def __init__(self) -> None:
        super().__init__(daemon=True, name="lateness")
        self._ended = threading.Event()
        self._lock = threading.Lock()
        self._worst_s = 0.0

    def run(self) -> None:
        while not self._ended.is_set():
            began_s, ran_s = time.monotonic(), time.process_time()
            self._ended.wait(PROBE_PERIOD_S)
            late_s = time.monotonic() - began_s - PROBE_PERIOD_S - (time.process_time() - ran_s)
            with self._lock:
                self._worst_s = max(self._worst_s, late_s)

    def collect(self) -> list[Late]:
        """The worst since the last call."""
        with self._lock:
            worst_s, self._worst_s = self._worst_s, 0.0
        return [Late("test process", worst_s, time.monotonic())]

    def end(self) -> None:
        self._ended.set()
        self.join()
