"""Lines that say how far something is: in place on a terminal, now and then elsewhere."""

from __future__ import annotations

import shutil
import time
from collections.abc import Sequence
from typing import TextIO

IN_PLACE_EVERY_S = 0.2
UP, ERASE_DOWN = "\x1b[{}F", "\x1b[J"


class Screen:
    """`quiet` shows nothing. Where nobody reads any more nothing is shown, either; what is under way goes on."""

    def __init__(self, quiet: bool, out: TextIO, plain_every_s: float) -> None:
        self._quiet = quiet
        self._out = out
        self._in_place = out.isatty()
        self._every_s = IN_PLACE_EVERY_S if self._in_place else plain_every_s
        # Of the machine's clock, which people read by. What is over at once needs no plain line.
        self._next_s = time.monotonic() + (0.0 if self._in_place else plain_every_s)
        self._lines_up = 0

    def is_due(self) -> bool:
        return not self._quiet and time.monotonic() >= self._next_s

    def make_due(self) -> None:
        self._next_s = 0.0

    def show(self, lines: Sequence[str]) -> None:
        """Instead of the lines before, where that can be."""
        self._next_s = time.monotonic() + self._every_s
        if not self._in_place:
            self._write("".join(line + "\n" for line in lines))
            return
        width = shutil.get_terminal_size().columns - 1  # a line that wraps would spoil the way back up
        self.clear()
        self._write("".join(line[:width] + "\n" for line in lines))
        self._lines_up = len(lines)

    def clear(self) -> None:
        """Out of the way of what is printed next; plain lines stay."""
        if self._lines_up:
            self._write(UP.format(self._lines_up) + ERASE_DOWN)
            self._lines_up = 0

    def _write(self, text: str) -> None:
        if self._quiet:
            return
        try:
            self._out.write(text)
            self._out.flush()
        except BrokenPipeError:
            self._quiet = True
