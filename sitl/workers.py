"""Independent computations in processes of their own, one for each core; none outlives the block that wanted it, or its parent.

Each process has a pipe of its own and a thread of the parent that minds it. Nothing else is shared, so a process may be
killed at any moment: its pipe breaks, and that is an error, not a wait for ever.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from sitl.ending import FailedError

Job = TypeVar("Job")
Result = TypeVar("Result")

LOOK_EVERY_S = 0.1
OF_A_TERMINAL = {signal.SIGINT, signal.SIGHUP}  # these reach every process of it
TOLD, DONE, RAISED = "told", "done", "raised"  # what comes through a pipe, each with a value


class WorkerDiedError(FailedError):
    """A process was killed from outside."""

    def __str__(self) -> str:
        return "a process ended before its work did, most likely for want of memory; free some, or ask for less"


class Running(Generic[Job, Result]):
    """Jobs under way. Nothing blocks but `wait` and `results`."""

    def __init__(
        self, jobs: Sequence[Job], weights: Sequence[float], pipes: Sequence[Connection], threads: ThreadPoolExecutor
    ) -> None:
        self._weights, self._shares = weights, [0.0] * len(jobs)
        self._idle: SimpleQueue[Connection] = SimpleQueue()
        for pipe in pipes:
            self._idle.put(pipe)
        heaviest_first = sorted(range(len(jobs)), key=lambda place: -weights[place])  # no core is to wait at the end
        futures = {place: threads.submit(self._mind, place, jobs[place]) for place in heaviest_first}
        self._futures = [futures[place] for place in range(len(jobs))]

    @property
    def share_done(self) -> float:
        """0 to 1, of all jobs' weights."""
        done = sum(weight * share for weight, share in zip(self._weights, self._shares, strict=True))
        return done / (sum(self._weights) or 1.0)

    def wait(self, seconds: float | None = None) -> bool:
        """Until all are done or one has failed, for so long at most. Is it over?"""
        done, others = wait(self._futures, seconds, FIRST_EXCEPTION)
        return not others or any(future.exception() for future in done)

    def results(self) -> list[Result]:
        """In the order of the jobs. Raises at once what a job raised, and WorkerDiedError."""
        self.wait()
        failed = [future for future in self._futures if future.done() and future.exception()]
        return [future.result() for future in failed or self._futures]

    def results_so_far(self) -> list[Result | None]:
        """In the order of the jobs; None for those that are not done or have failed."""
        return [future.result() if future.done() and not future.exception() else None for future in self._futures]

    def _mind(self, place: int, job: Job) -> Result:
        """In a thread: one job from its beginning to its end."""
        pipe = self._idle.get()
        try:
            pipe.send(job)
            while (said := pipe.recv())[0] == TOLD:
                self._shares[place] = said[1]
        except (EOFError, OSError):
            raise WorkerDiedError from None
        finally:
            self._idle.put(pipe)
        if said[0] == RAISED:
            raise said[1]
        self._shares[place] = 1.0
        result: Result = said[1]
        return result


@contextmanager
def running(
    work: Callable[[Job], Result], jobs: Sequence[Job], weights: Sequence[float] = (), workers: int | None = None
) -> Iterator[Running[Job, Result]]:
    """Start all jobs, the heaviest first; however the block ends, no process is left. `work` is a function of a module.

    Processes are spawned, not forked: the parent has threads, and a fork of those is a gamble.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")  # one process a core is enough; the children read it when they start
    count = min(len(jobs), workers or len(os.sched_getaffinity(0)))
    context = multiprocessing.get_context("spawn")
    processes: list[BaseProcess] = []
    pipes: list[Connection] = []
    threads = ThreadPoolExecutor(max(1, count))
    try:
        with _no_interrupt():
            for _ in range(count):
                ours, theirs = context.Pipe()
                started = context.Process(target=_serve, args=(work, theirs), daemon=True)
                started.start()
                processes.append(started)
                pipes.append(ours)
                theirs.close()  # from now on the pipe breaks when the process ends
        yield Running(jobs, weights or [1.0] * len(jobs), pipes, threads)
    finally:
        with _no_interrupt():
            for process in processes:
                process.kill()
            threads.shutdown(cancel_futures=True)
            for process in processes:
                process.join()


def in_processes(
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    progress: Callable[[float], None],
    weights: Sequence[float] = (),
) -> list[Result]:
    """The results in the order of the jobs. `progress` is told the share done, again and again."""
    with running(work, jobs, weights) as under_way:
        while not under_way.wait(LOOK_EVERY_S):
            progress(under_way.share_done)
        return under_way.results()


def tell(share: float) -> None:
    """For a long job: how much of it is done. Does nothing outside these processes."""
    if _parent:
        _parent.send((TOLD, share))


@contextmanager
def _no_interrupt() -> Iterator[None]:
    """Processes that start in here never hear Ctrl-C: the parent alone decides what it means."""
    resource_tracker.ensure_running()  # it would start with the first process, and let signals through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, OF_A_TERMINAL)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_parent: Connection | None = None  # in one of the processes


def _serve(work: Callable[[Any], Any], parent: Connection) -> None:
    """In a process: one job after the other."""
    global _parent
    _parent = parent
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):  # the parent has gone
        while True:
            job = parent.recv()
            try:
                parent.send((DONE, work(job)))
            except Exception as error:  # noqa: BLE001 -- whatever it is, the parent wants to know
                error.add_note(traceback.format_exc())
                parent.send((RAISED, error))


def _end_with_parent() -> None:
    """A parent that is killed cannot end its children."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
