"""Lines that show the state of something: refreshed in place on a terminal, printed at intervals elsewhere."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

IN_PLACE_EVERY_S = 0.2
FIRST_PLAIN_AFTER_S = 2.0  # a computation that is over at once prints no plain line


class _Console(Console):
    """After its reader has gone it prints nothing more: the flight that it shows goes on."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


class Screen:
    """`quiet` shows nothing. `transient` lines are removed from a terminal at the end; plain lines always remain."""

    def __init__(self, quiet: bool, out: TextIO, plain_every_s: float, transient: bool) -> None:
        self._console = _Console(file=out, quiet=quiet, markup=False, highlight=False, emoji=False)
        in_place = self._console.is_terminal and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False, transient=transient) if in_place else None
        self._every_s = IN_PLACE_EVERY_S if in_place else plain_every_s
        self._next_s = time.monotonic() + (0.0 if in_place else FIRST_PLAIN_AFTER_S)  # on the clock of the machine

    def is_due(self) -> bool:
        return not self._console.quiet and time.monotonic() >= self._next_s

    def make_due(self) -> None:
        self._next_s = 0.0

    def show(self, lines: Sequence[str]) -> None:
        """Replace the lines shown before, or print below them."""
        if self._console.quiet:
            return
        self._next_s = time.monotonic() + self._every_s
        text = Text("\n".join(lines), no_wrap=True, overflow="crop")
        if self._live is None:
            self._console.print(text, soft_wrap=True)
            return
        self._live.start()
        self._live.update(text, refresh=True)

    def close(self) -> None:
        """Later output follows below; transient lines are removed."""
        if self._live is not None:
            self._live.stop()
