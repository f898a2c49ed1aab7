"""Independent flights in processes of their own, one for each core; all end soon after they are told to."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from multiprocessing.synchronize import Event

from sitl.paper.flights import FlownPlan, Plan, fly

_to_end: Event | None = None  # in a worker: set when the flight under way is not wanted any more


class NotWantedError(Exception):
    """Ends a flight whose report nobody waits for."""


class Flying:
    """Flights under way. Nothing blocks but `results`."""

    def __init__(self, futures: Sequence[Future[FlownPlan]]) -> None:
        self._futures = futures

    @property
    def share_done(self) -> float:
        return sum(future.done() for future in self._futures) / max(1, len(self._futures))

    def wait(self, seconds: float) -> bool:
        """Until all are done, for so long at most. Are they?"""
        return not wait(self._futures, timeout=seconds).not_done

    def results(self) -> list[FlownPlan]:
        """In the order of the plans. Raises what a flight raised."""
        return [future.result() for future in self._futures]


@contextmanager
def flying(plans: Sequence[Plan], workers: int | None = None) -> Iterator[Flying]:
    """Start all plans; however the block ends, nothing flies after it.

    Processes are spawned, not forked: the parent has threads, and a fork of those is a gamble.
    """
    context = multiprocessing.get_context("spawn")
    to_end = context.Event()
    workers = min(len(plans), workers or os.cpu_count() or 1)
    with ProcessPoolExecutor(max(1, workers), context, _begin_worker, (to_end,)) as pool:
        try:
            with _no_interrupt():
                futures = [pool.submit(_fly, plan) for plan in plans]
            yield Flying(futures)
        finally:
            to_end.set()
            pool.shutdown(wait=True, cancel_futures=True)


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Workers are born in here and inherit the mask: a Ctrl-C before they could ignore it would spill a traceback."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin_worker(to_end: Event) -> None:
    """Ctrl-C reaches every process of a terminal; here the parent alone decides what it means."""
    global _to_end
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    _to_end = to_end
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that is killed cannot stop its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _check() -> None:
    if _to_end and _to_end.is_set():
        raise NotWantedError


def _fly(plan: Plan) -> FlownPlan:
    return fly(plan, _check)
