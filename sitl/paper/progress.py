"""How far a reproduction is: one line, in place on a terminal, now and then elsewhere."""

from __future__ import annotations

import sys
import time
from typing import TextIO

IN_PLACE_EVERY_S, PLAIN_EVERY_S = 0.2, 10.0
ERASE_LINE = "\r\x1b[K"


class PaperProgress:
    """`quiet` shows nothing."""

    def __init__(self, quiet: bool, out: TextIO | None = None) -> None:
        self._quiet = quiet
        self._out = out or sys.stdout
        self._in_place = self._out.isatty()
        self._began_s = time.monotonic()
        self._next_s = 0.0

    def show(self, theory_share: float, flights_share: float) -> None:
        """Theory and flights go on side by side; each share is 0 to 1."""
        if time.monotonic() >= self._next_s:
            self.say(f"theory {theory_share:4.0%}   flights {flights_share:4.0%}")

    def say(self, what: str) -> None:
        if self._quiet:
            return
        now_s = time.monotonic()
        self._next_s = now_s + (IN_PLACE_EVERY_S if self._in_place else PLAIN_EVERY_S)
        line = f"paper   {what}   ({now_s - self._began_s:.0f} s)"
        self._write(f"{ERASE_LINE}{line}" if self._in_place else f"{line}\n")

    def clear(self) -> None:
        if self._in_place and not self._quiet:
            self._write(ERASE_LINE)

    def _write(self, text: str) -> None:
        try:
            self._out.write(text)
            self._out.flush()
        except BrokenPipeError:  # nobody reads any more; the report is written all the same
            self._quiet = True
