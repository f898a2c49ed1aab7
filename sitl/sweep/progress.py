"""How far a sweep is: one line, in place on a terminal, now and then elsewhere."""

from __future__ import annotations

import shutil
import sys
import time
from typing import TextIO

from sitl.progress import IN_PLACE_EVERY_S, PLAIN_EVERY_S

BACK, ERASE_LINE = "\r", "\x1b[K"
TELLING = 0.01  # below this share nobody knows how long it takes


class SweepProgress:
    """`quiet` shows nothing."""

    def __init__(self, quiet: bool, out: TextIO | None = None) -> None:
        self._quiet = quiet
        self._out = out or sys.stdout
        self._in_place = self._out.isatty()
        self._next_s = time.monotonic() + (0.0 if self._in_place else PLAIN_EVERY_S)
        self._shown = False

    def checked(self, number: int, of: int) -> None:
        self._show(f"checking combination {number} of {of}")

    def flown(self, share: float, flights: int, of: int, elapsed_s: float) -> None:
        left = f", {_minutes(elapsed_s * (1.0 / share - 1.0))} left" if share >= TELLING else ""
        self._show(f"{100.0 * share:3.0f} %   {flights} of {of} flights done{left}")

    def end(self) -> None:
        """Out of the way of what is printed next."""
        if self._in_place and self._shown:
            self._write(BACK + ERASE_LINE)

    def _show(self, line: str) -> None:
        if self._quiet or time.monotonic() < self._next_s:
            return
        self._next_s = time.monotonic() + (IN_PLACE_EVERY_S if self._in_place else PLAIN_EVERY_S)
        self._shown = True
        if self._in_place:
            width = shutil.get_terminal_size().columns - 1  # a line that wraps cannot be gone back over
            self._write(BACK + ERASE_LINE + line[:width])
        else:
            self._write(line + "\n")

    def _write(self, text: str) -> None:
        try:
            self._out.write(text)
            self._out.flush()
        except BrokenPipeError:  # nobody reads any more; the sweep goes on
            self._quiet = True


def _minutes(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} h"
