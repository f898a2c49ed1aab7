"""How much of a long computation is done, how long it has taken and will still take."""

from __future__ import annotations

import sys
import time
from types import TracebackType
from typing import Self, TextIO

from sitl.screen import Screen

PLAIN_EVERY_S = 10.0
TELLING = 0.01  # below this share nobody knows how long it takes


class ShareProgress:
    """One line on standard error, so that results can be piped; gone from a terminal when the block ends."""

    def __init__(self, quiet: bool, out: TextIO | None = None) -> None:
        self._screen = Screen(quiet, out or sys.stderr, PLAIN_EVERY_S)
        self._began_s = time.monotonic()
        self._stage, self._stage_began_s = "", self._began_s

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._screen.clear()

    def begin(self, stage: str) -> None:
        """Shares count from 0 again, and what is left is that of this stage."""
        self._stage, self._stage_began_s = stage, time.monotonic()

    def show(self, share: float, more: str = "") -> None:
        """`share` of the stage, 0 to 1; `more` in words."""
        if not self._screen.is_due():
            return
        now_s = time.monotonic()
        times = _duration(now_s - self._began_s)
        if share >= TELLING:
            times += f", {_duration((now_s - self._stage_began_s) * (1.0 / share - 1.0))} left"
        self._screen.show(["   ".join(filter(None, (f"{self._stage} {share:4.0%}", more, times)))])


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} h"
