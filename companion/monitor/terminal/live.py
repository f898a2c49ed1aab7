"""The live picture on a terminal, refreshed in place on its second screen: at the end the terminal is as it was before."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from types import FrameType

from rich.console import Console
from rich.live import Live
from rich.text import Text

from companion.ground.fleet_status import VehicleRow
from companion.monitor.terminal.page import Line, Style, fitted_page

PERIOD_S = 0.2


def show_live(vehicles: Callable[[], Sequence[VehicleRow]], endpoints: Sequence[str]) -> None:
    """Until Ctrl-C, which is raised as KeyboardInterrupt, as is SIGTERM."""
    console = Console(highlight=False)
    with _ended_by_sigterm(), Live(console=console, screen=True, auto_refresh=False, transient=True) as screen:
        while True:
            width, height = console.size
            lines = fitted_page(vehicles(), width, height, time.monotonic()) or _nothing_yet(endpoints)
            screen.update(as_text(lines), refresh=True)
            time.sleep(PERIOD_S)


def _nothing_yet(endpoints: Sequence[str]) -> list[Line]:
    return [Line(f"no report yet from {', '.join(endpoints)}", Style.QUIET), Line("Ctrl-C ends", Style.QUIET)]


def as_text(lines: Sequence[Line]) -> Text:
    """With the styles; NO_COLOR leaves their colours out."""
    return Text("\n").join(Text(shown.text, style=shown.style.value) for shown in lines)  # brackets are no markup


@contextmanager
def _ended_by_sigterm() -> Iterator[None]:
    """Without a handler a terminal that is killed would keep the second screen and hide its cursor."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
