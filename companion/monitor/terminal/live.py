"""The live picture on a terminal, refreshed in place on its second screen: at the end the terminal is as it was before."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import FrameType
from typing import TYPE_CHECKING, Self

import zenoh

from companion.ground.fleet_status import VehicleRow
from companion.monitor.terminal.fleet_rows import Members
from companion.monitor.terminal.page import Line, Style, fitted_page

if TYPE_CHECKING:
    from rich.text import Text

PERIOD_S = 0.2
CONNECTIONS_EVERY_S = 3.0


def show_live(
    vehicles: Callable[[], Sequence[VehicleRow]],
    endpoints: Sequence[str],
    unreachable: Callable[[], Mapping[str, str]],
    members: Members,
) -> None:
    """Until Ctrl-C, which is raised as KeyboardInterrupt, as is SIGTERM.

    `unreachable` gives the reason by endpoint and may take seconds.
    """
    from rich.console import Console
    from rich.live import Live

    console = Console(highlight=False)
    with (
        _Connections(unreachable) as connections,
        _ended_by_sigterm(),
        Live(console=console, screen=True, auto_refresh=False, transient=True) as screen,
    ):
        while True:
            width, height = console.size
            above = top_lines(time.strftime("%H:%M:%S"), connections.failed, width)
            room = height - len(above)
            lines = fitted_page(vehicles(), width, room, time.monotonic(), members) or _nothing_yet(endpoints)
            screen.update(as_text([*above, *lines]), refresh=True)
            time.sleep(PERIOD_S)


def top_lines(clock: str, failed: Mapping[str, str], width: int) -> list[Line]:
    """The time of this picture, so that a connection that stalls is seen, and the endpoints that are not reached."""
    lines = [Line(clock, Style.QUIET)]
    if failed:
        text = "not reached: " + "; ".join(f"{endpoint}: {reason}" for endpoint, reason in failed.items())
        lines.append(Line(text if len(text) <= width else f"{text[: width - 1]}…", Style.WARNING))
    return lines


class _Connections:
    """Looks at the endpoints in a thread."""

    def __init__(self, unreachable: Callable[[], Mapping[str, str]]) -> None:
        self.failed: Mapping[str, str] = {}
        self._unreachable = unreachable
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, daemon=True)

    def _look(self) -> None:
        while not self._ended.wait(CONNECTIONS_EVERY_S):
            with contextlib.suppress(zenoh.ZError, OSError):  # the picture goes on without it
                self.failed = self._unreachable()

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join(2.0)


def _nothing_yet(endpoints: Sequence[str]) -> list[Line]:
    return [Line(f"no report yet from {', '.join(endpoints)}", Style.QUIET), Line("Ctrl-C ends", Style.QUIET)]


def as_text(lines: Sequence[Line]) -> Text:
    """With the styles; NO_COLOR leaves their colours out."""
    from rich.text import Text

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
