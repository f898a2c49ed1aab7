"""`companion monitor --record`: what the ground receives and commands, in a recording of its own."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from math import inf
from pathlib import Path

from companion.config.fleet import FleetConfig
from companion.ground.session import FleetSession
from companion.monitor.sources import TimedReport
from companion.recording.writer.ground_recorder import ground_recorder
from companion.recording.writer.writing import WritingThread
from companion.types.notices import Notice

STEP_S = 1.0


class GroundRecording:
    """A listener of the Station. The disk never delays it: a thread writes."""

    def __init__(
        self, folder: Path, session: FleetSession, fleet: FleetConfig | None, report: Callable[[Notice], None]
    ) -> None:
        """`report` gets what is to be known of the recording, like a full disk."""
        self._session = session
        self._report = report
        unix_s, monotonic_s = time.time(), time.monotonic()
        name = fleet.name if fleet else session.fleet
        self._recorder = ground_recorder(name, fleet, folder, unix_s, monotonic_s, WritingThread())
        self._stepped_s = -inf

    def listen(self, reports: Sequence[TimedReport], now_s: float) -> None:
        for arrived_s, report in reports:
            self._recorder.status(report, arrived_s)
        for command in self._session.drain_commands():
            self._recorder.command(command, now_s)
        if now_s - self._stepped_s >= STEP_S:
            self._stepped_s = now_s
            if notice := self._recorder.step(now_s):
                self._report(notice)

    def close(self) -> None:
        self._recorder.close()
