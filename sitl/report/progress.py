"""What is shown while a command works: the live view of a flight, and the share done of a long computation.

Lines are refreshed in place on a terminal; elsewhere one is printed at intervals.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from textwrap import wrap
from typing import TextIO

from rich.console import Console, ConsoleDimensions
from rich.live import Live
from rich.text import Text

from companion.ground.fleet_state import ReportedVehicle
from sitl.report.vehicle_table import VehicleTable

VIEW_EVERY_S = 5.0


class FlightProgress(AbstractContextManager["FlightProgress"]):
    """Shows one flight. Its times are arguments, because it may fly in virtual time. `quiet` shows nothing."""

    def __init__(self, name: str, quiet: bool, began_s: float, out: TextIO | None = None) -> None:
        self._name = name
        self._screen = Screen(quiet, out or sys.stdout, VIEW_EVERY_S)
        self._screen.make_due()
        self._began_s = began_s
        self._step, self._step_began_s, self._step_lasts_s = "starting", self._began_s, 0.0
        self._remark = ""
        self._table = VehicleTable()

    def __exit__(self, *_exception: object) -> None:
        self._screen.close()

    def begin_step(self, step: str, since_s: float, lasts_s: float = 0.0) -> None:
        """`lasts_s` is 0 if the duration is unknown."""
        self._screen.make_due()  # shown at once, however short the step before was
        self._step, self._step_began_s, self._step_lasts_s = step, since_s, lasts_s

    def remark(self, text: str) -> None:
        """A line below the headline until the next remark; "" removes it."""
        self._remark = text

    def is_due(self) -> bool:
        """Whether it is time to refresh."""
        return self._screen.is_due()

    def show(self, vehicles: Sequence[ReportedVehicle], now_s: float) -> None:
        """Refresh the view."""
        head, size = self._headline(now_s), self._screen.size
        if size is None:
            words, *flags = self._table.brief(vehicles, now_s)
            self._screen.show(["   ".join(filter(None, (head, words, self._remark))), *flags])
            return
        remark = wrap(f"  {self._remark}", size.width, subsequent_indent="  ")
        room = size.height - len(remark) - 2  # the headline, and the line of the cursor
        self._screen.show([head, *remark, *self._table.lines(vehicles, now_s, room)])

    def _headline(self, now_s: float) -> str:
        total = f" of {self._step_lasts_s:g}" if self._step_lasts_s else ""
        step_s = max(0.0, now_s - self._step_began_s)
        return f"{self._name}   {self._step}   {step_s:.1f}{total} s   (flight {now_s - self._began_s:.0f} s)"


IN_PLACE_EVERY_S = 0.2
FIRST_PLAIN_AFTER_S = 2.0  # a computation that is over at once prints no plain line


class _Console(Console):
    """After its reader has gone it prints nothing more: the flight that it shows goes on."""

    def on_broken_pipe(self) -> None:
        self.quiet = True


class Screen:
    """`quiet` shows nothing. From a terminal the lines are removed at the end; plain lines remain."""

    def __init__(self, quiet: bool, out: TextIO, plain_every_s: float) -> None:
        self._console = _Console(file=out, quiet=quiet, markup=False, highlight=False, emoji=False)
        in_place = self._console.is_terminal and not self._console.is_dumb_terminal
        self._live = Live(console=self._console, auto_refresh=False, transient=True) if in_place else None
        self._every_s = IN_PLACE_EVERY_S if in_place else plain_every_s
        self._next_s = time.monotonic() + (0.0 if in_place else FIRST_PLAIN_AFTER_S)  # on the clock of the machine

    def is_due(self) -> bool:
        return not self._console.quiet and time.monotonic() >= self._next_s

    def make_due(self) -> None:
        self._next_s = 0.0

    @property
    def size(self) -> ConsoleDimensions | None:
        """Of the terminal; None without one."""
        return self._console.size if self._live else None

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
        """Later output takes the place of the lines on a terminal."""
        if self._live is not None:
            self._live.stop()


SHARE_EVERY_S = 10.0
MEASURED_S, MEASURED_SHARE = 5.0, 0.01  # the time left is estimated after so long, and so much of the stage


class ShareProgress(AbstractContextManager["ShareProgress"]):
    """One line on standard error, so that results can be piped; removed from a terminal when the block ends."""

    def __init__(self, quiet: bool, out: TextIO | None = None) -> None:
        self._screen = Screen(quiet, out or sys.stderr, SHARE_EVERY_S)
        self._began_s = time.monotonic()
        self._stage = ""
        self._first: tuple[float, float] | None = None  # when the first share of the stage was done, and which

    def __exit__(self, *_exception: object) -> None:
        self._screen.close()

    def begin(self, stage: str) -> None:
        """Shares and the time left are those of this stage from now on."""
        self._stage, self._first = stage, None

    def show(self, share: float, more: str = "") -> None:
        """`share` of the stage done, 0 to 1; `more` is shown beside it."""
        now_s = time.monotonic()
        if self._first is None and share > 0.0:
            self._first = now_s, share
        if not self._screen.is_due():
            return
        times = ", ".join([_duration(now_s - self._began_s), *self._left(now_s, share)])
        self._screen.show(["   ".join(filter(None, (f"{self._stage} {share:4.0%}", more, times)))])

    def _left(self, now_s: float, share: float) -> list[str]:
        """The time left, as soon as it is known. The start of the workers does not count: it takes seconds and does nothing."""
        first_s, first = self._first or (now_s, share)
        measured_s, done = now_s - first_s, share - first
        if measured_s < MEASURED_S or done < MEASURED_SHARE:
            return []
        return [f"{_duration(measured_s * (1.0 - share) / done)} left"]


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60.0)
    return f"{minutes} min" if minutes < 120 else f"{minutes / 60.0:.1f} h"
