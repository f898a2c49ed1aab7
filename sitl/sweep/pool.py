"""Chunks in processes of their own, one for each core; all end soon after they are told to."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing.sharedctypes import Synchronized
from multiprocessing.synchronize import Event

from sitl.sweep.flights import Chunk, FlightFigures, fly_chunk

OF_A_TERMINAL = {signal.SIGINT, signal.SIGHUP}  # these reach every process of it


class NotWantedError(Exception):
    """Ends a chunk whose figures nobody waits for."""


@dataclass(frozen=True, slots=True)
class Shared:
    """Between the parent and its workers. `flown_s` are seconds of formation, of all chunks together."""

    to_end: Event
    flown_s: Synchronized[float]


_shared: Shared | None = None  # in a worker


class Flying:
    """Chunks under way. Nothing blocks but `wait`."""

    def __init__(self, chunks: Sequence[Chunk], futures: Sequence[Future[list[FlightFigures]]], shared: Shared) -> None:
        self._chunks, self._futures, self._shared = chunks, futures, shared
        self._work_s = sum(chunk.work_s for chunk in chunks)

    @property
    def share_done(self) -> float:
        return min(1.0, self._shared.flown_s.value / self._work_s)

    @property
    def flights_done(self) -> int:
        return sum(
            len(chunk.flights) for chunk, future in zip(self._chunks, self._futures, strict=True) if future.done()
        )

    def wait(self, seconds: float) -> bool:
        """Until all are done, for so long at most. Are they?"""
        return not wait(self._futures, timeout=seconds).not_done

    def results(self) -> list[list[FlightFigures]]:
        """In the order of the chunks. Raises what a chunk raised."""
        return [future.result() for future in self._futures]

    def results_so_far(self) -> list[list[FlightFigures]]:
        """The same, with nothing for chunks that are not complete."""
        return [future.result() if _is_complete(future) else [] for future in self._futures]


def _is_complete(future: Future[list[FlightFigures]]) -> bool:
    return future.done() and not future.cancelled() and future.exception() is None


@contextmanager
def flying(chunks: Sequence[Chunk], workers: int | None = None) -> Iterator[Flying]:
    """Start all chunks; however the block ends, nothing flies after it.

    Processes are spawned, not forked: numpy has threads, and a fork of those is a gamble.
    """
    context = multiprocessing.get_context("spawn")
    shared = Shared(context.Event(), context.Value("d", 0.0))
    workers = min(len(chunks), workers or len(os.sched_getaffinity(0)))
    with ProcessPoolExecutor(workers, context, _begin_worker, (shared,)) as pool:
        try:
            # What is blocked now stays so in the workers, from their first moment on: the parent alone decides what
            # Ctrl-C means.
            before = signal.pthread_sigmask(signal.SIG_BLOCK, OF_A_TERMINAL)
            try:
                futures = [pool.submit(_fly, chunk) for chunk in chunks]
            finally:
                signal.pthread_sigmask(signal.SIG_SETMASK, before)
            yield Flying(chunks, futures, shared)
        finally:
            shared.to_end.set()
            pool.shutdown(wait=True, cancel_futures=True)


def _begin_worker(shared: Shared) -> None:
    global _shared
    _shared = shared
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """A parent that is killed cannot stop its workers."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _fly(chunk: Chunk) -> list[FlightFigures]:
    assert _shared is not None
    shared, told_s = _shared, 0.0

    def tell(time_s: float) -> None:
        nonlocal told_s
        if shared.to_end.is_set():
            raise NotWantedError
        with shared.flown_s.get_lock():
            shared.flown_s.value += (time_s - told_s) * len(chunk.flights)
        told_s = time_s

    tell(0.0)
    figures = fly_chunk(chunk, tell)
    tell(chunk.duration_s)
    return figures
