"""Runs independent jobs in a pool of processes, one for each core, with shared progress and a prompt end.

`Workers` is the interface; sitl/cluster runs the same jobs on many machines. LocalWorkers adds to ProcessPoolExecutor: progress
of each job in shared memory, workers that ignore Ctrl-C, and a pipe that ends all workers when the block or the parent process
ends.
"""

from __future__ import annotations

import multiprocessing
import os
import pickle
import signal
import threading
from collections.abc import Callable, Iterator, MutableSequence, Sequence
from concurrent.futures import FIRST_EXCEPTION, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import AbstractContextManager, contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from functools import partial
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Generic, Protocol, TypeVar

from companion.types.errors import FailedError

Job = TypeVar("Job")
Result = TypeVar("Result")
Shares = MutableSequence[float]  # of each job, 0 to 1
Report = Callable[[float], None]  # takes the share of a job that is done, 0 to 1

POLL_S = 0.5  # period in which callers update their progress display; each look at 1,000 jobs takes 10 ms
TERMINAL_SIGNALS = {signal.SIGINT, signal.SIGHUP}  # a terminal sends these to every process of its group


class WorkerDiedError(FailedError):
    """A worker process ended before its job did."""

    def __str__(self) -> str:
        return (
            "a worker process ended before its job, most likely for lack of memory; free some memory, or ask for less"
        )


class RunningJobs(Generic[Result]):
    """Jobs in progress. Only `wait` and `results` block.

    `check` raises what prevents the jobs from ending; it is called while they are waited for.
    """

    def __init__(
        self,
        futures: Sequence[Future[Result]],
        weights: Sequence[float],
        shares: Shares,
        check: Callable[[], None] = lambda: None,
    ) -> None:
        self._futures, self._weights, self._shares, self._check = futures, weights, shares, check

    @property
    def share_done(self) -> float:
        """Share of the work that is done, 0 to 1, weighted by the weights of the jobs."""
        shares = (1.0 if future.done() else share for future, share in zip(self._futures, self._shares, strict=True))
        return sum(w * share for w, share in zip(self._weights, shares, strict=True)) / (sum(self._weights) or 1.0)

    def wait(self, seconds: float) -> bool:
        """Wait until all jobs are done or one has failed, at most `seconds`. Returns whether that is the case."""
        done, others = wait(self._futures, seconds, FIRST_EXCEPTION)
        if not others or any(future.exception() for future in done):
            return True
        self._check()
        return False

    def results(self) -> list[Result]:
        """Results in the order of the jobs. Raises what a job raised as soon as it did, and WorkerDiedError."""
        while not self.wait(POLL_S):
            pass
        failed = [future for future in self._futures if future.done() and future.exception()]
        try:
            return [future.result() for future in failed or self._futures]
        except BrokenProcessPool as error:
            raise WorkerDiedError from error

    def results_so_far(self) -> list[Result | None]:
        """Results in the order of the jobs; None for jobs that are not done or have failed."""
        return [future.result() if future.done() and not future.exception() else None for future in self._futures]


class Workers(Protocol):
    """Where jobs run."""

    def running(
        self, work: Callable[[Job], Result], jobs: Sequence[Job], weights: Sequence[float] = ()
    ) -> AbstractContextManager[RunningJobs[Result]]:
        """Start all jobs, those with the largest weight first. `work` is a function of a module.

        When the block ends, jobs that are not done are cancelled.
        """
        ...


@dataclass(frozen=True, slots=True)
class LocalWorkers:
    """Processes of this machine; `count` is None for one on each core."""

    count: int | None = None

    @contextmanager
    def running(
        self, work: Callable[[Job], Result], jobs: Sequence[Job], weights: Sequence[float] = ()
    ) -> Iterator[RunningJobs[Result]]:
        """See Workers. When the block ends, all processes end with it. They are spawned, not forked: a fork copies locks that
        other threads of the parent hold.
        """
        os.environ.setdefault("OMP_NUM_THREADS", "1")  # workers inherit it: one thread for each process
        context = multiprocessing.get_context("spawn")
        shares: Shares = context.RawArray("d", len(jobs))  # in memory that all processes share
        parent_is_alive, ours = context.Pipe(duplex=False)
        count = max(1, min(len(jobs), self.count or len(os.sched_getaffinity(0))))
        pool = ProcessPoolExecutor(count, context, _start_worker, (parent_is_alive, shares))
        weights = weights or [1.0] * len(jobs)
        # A thread of the pool would wait for ever to write a job that a pipe cannot hold, once no worker reads (CPython
        # gh-94777): the pipe gets the path of its file.
        folder = TemporaryDirectory(prefix="jobs-")
        try:
            files = [Path(folder.name) / str(index) for index in range(len(jobs))]
            for file, job in zip(files, jobs, strict=True):
                file.write_bytes(pickle.dumps((work, job)))
            with _terminal_signals_blocked():
                futures = {index: pool.submit(_do, index, files[index]) for index in heaviest_first(weights)}
                # The pool looks for dead workers among those that it knew at the last submission. A worker is started after
                # that look, so one more job, which does nothing, makes the pool watch the last worker too.
                pool.submit(_do_nothing)
            yield RunningJobs([futures[index] for index in range(len(jobs))], weights, shares)
        finally:
            with _terminal_signals_blocked():
                ours.close()
                pool.shutdown(cancel_futures=True)
                parent_is_alive.close()
                folder.cleanup()


def heaviest_first(weights: Sequence[float]) -> list[int]:
    """The jobs in the order of their start, by which no worker idles at the end."""
    return sorted(range(len(weights)), key=lambda index: -weights[index])


def all_results(
    workers: Workers,
    work: Callable[[Job], Result],
    jobs: Sequence[Job],
    progress: Callable[[float], None],
    weights: Sequence[float] = (),
) -> list[Result]:
    """Results in the order of the jobs. Calls `progress` with the share done every POLL_S."""
    with workers.running(work, jobs, weights) as in_progress:
        while not in_progress.wait(POLL_S):
            progress(in_progress.share_done)
        return in_progress.results()


_report: ContextVar[Report | None] = ContextVar("report", default=None)


def report_progress(share: float) -> None:
    """Publish how much of the current job is done, 0 to 1. Does nothing outside a worker."""
    report = _report.get()
    if report is not None:
        report(share)


@contextmanager
def reporting_to(report: Report) -> Iterator[None]:
    """In this block `report` gets what report_progress publishes in this thread."""
    token = _report.set(report)
    try:
        yield
    finally:
        _report.reset(token)


@contextmanager
def _terminal_signals_blocked() -> Iterator[None]:
    """Block TERMINAL_SIGNALS here and in all processes started here: only the parent acts on Ctrl-C."""
    resource_tracker.ensure_running()  # its start would unblock the signals
    before = signal.pthread_sigmask(signal.SIG_BLOCK, TERMINAL_SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_shares: Shares | None = None  # in a worker process: of all jobs


def _start_worker(parent_is_alive: Connection, shares: Shares) -> None:
    """In each worker, before its first job."""
    global _shares
    _shares = shares
    threading.Thread(target=_end_with_parent, args=(parent_is_alive,), daemon=True).start()


def _end_with_parent(parent_is_alive: Connection) -> None:
    """Exit when the parent closes its end of the pipe, which also happens when it is killed."""
    parent_is_alive.poll(None)
    os._exit(1)


def _do_nothing() -> None:
    pass


def _do(index: int, file: Path) -> Any:
    """The result of the work in this file."""
    assert _shares is not None
    work, job = pickle.loads(file.read_bytes())
    with reporting_to(partial(_shares.__setitem__, index)):
        return work(job)
