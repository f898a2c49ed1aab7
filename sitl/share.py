"""How much of a long computation is done, and how long it will still take."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn

PLAIN_STEP = 0.1  # where nobody can redraw a line, one is printed for each tenth


@contextmanager
def share_shown(title: str, quiet: bool) -> Iterator[Callable[[float], None]]:
    """Call what it gives with the share done, 0 to 1. On standard error, so that results can be piped."""
    if quiet:
        yield lambda _share: None
    elif not sys.stderr.isatty():
        yield _Lines(title)
    else:
        columns = (
            TextColumn("{task.description}"),
            BarColumn(),
            TaskProgressColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
        )
        with Progress(*columns, console=Console(stderr=True)) as progress:
            task = progress.add_task(title, total=1.0)
            yield lambda share: progress.update(task, completed=share)


class _Lines:
    def __init__(self, title: str) -> None:
        self._title = title
        self._next = 0.0

    def __call__(self, share: float) -> None:
        if share >= self._next:
            self._next = share + PLAIN_STEP
            print(f"{self._title}: {100 * share:.0f} %", file=sys.stderr, flush=True)
