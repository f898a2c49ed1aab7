"""Independent computations in processes of their own, one for each core; none outlives its parent."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

Job = TypeVar("Job")
Result = TypeVar("Result")


def in_processes(work: Callable[[Job], Result], jobs: Sequence[Job]) -> Iterator[tuple[int, Result]]:
    """(place in `jobs`, result) as they come. Ends every process at once when the caller stops listening or is interrupted.

    Processes are spawned, not forked: the parent may have threads, and a fork of those is a gamble. `work` must be a
    function of a module. Raises what `work` raises.
    """
    count = min(len(jobs), os.cpu_count() or 1)
    if count == 0:
        return
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process a core is enough; the children read it when they start
    context = multiprocessing.get_context("spawn")
    with context.Pool(count, _begin) as pool:  # leaving the block ends the processes
        yield from pool.imap_unordered(partial(_numbered, work), list(enumerate(jobs)))


def _numbered(work: Callable[[Job], Result], numbered: tuple[int, Job]) -> tuple[int, Result]:
    place, job = numbered
    return place, work(job)


def _begin() -> None:
    """Ctrl-C reaches every process of a terminal; here the parent alone decides what it means."""
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that is killed cannot end its children."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
