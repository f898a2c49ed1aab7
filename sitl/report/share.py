"""Progress of a long computation: share done, time taken, time left."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self, TextIO

from sitl.report.screen import Screen

SHARE_EVERY_S = 10.0
LEAST_SHARE = 0.01  # below it the time left cannot be estimated


class ShareProgress:
    """One line on standard error, so that results can be piped; removed from a terminal when the block ends."""

    def __init__(self, quiet: bool, out: TextIO | None = None) -> None:
        self._screen = Screen(quiet, out or sys.stderr, SHARE_EVERY_S, transient=True)
        self._began_s = time.monotonic()
        self._stage, self._stage_began_s = "", self._began_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._screen.close()

    def begin(self, stage: str) -> None:
        """Shares and the time left are those of this stage from now on."""
        self._stage, self._stage_began_s = stage, time.monotonic()

    def show(self, share: float, more: str = "") -> None:
        """`share` of the stage done, 0 to 1; `more` is shown beside it."""
        if not self._screen.is_due():
            return
        now_s = time.monotonic()
        times = _duration(now_s - self._began_s)
        if share >= LEAST_SHARE:
            times += f", {_duration((now_s - self._stage_began_s) * (1.0 / share - 1.0))} left"
        self._screen.show(["   ".join(filter(None, (f"{self._stage} {share:4.0%}", more, times)))])


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} h"
