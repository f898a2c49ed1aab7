"""One job as a task of Dask: what runs in a worker, and what it reports to the client."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TypeVar

from distributed import Worker, get_worker
from msgspec import Struct

from sitl.cluster.software import differences, software
from sitl.errors import UnusableError
from sitl.workers import reporting_to

Job = TypeVar("Job")
Result = TypeVar("Result")

TOPIC = "sitl progress"  # one for all runs: the scheduler keeps the last events of every topic for ever
REPORT_S = 0.5


class UnfitError(UnusableError):
    """A machine of the cluster cannot give the results of this one. str() is one line that names it and what differs."""


class CancelledTaskError(Exception):
    """The client no longer wants the result of this task. Nobody sees this error."""


class ClusterRun(Struct, frozen=True):
    """Jobs that a client started together: an identity, and the software of the client."""

    id: str
    software: dict[str, str]


def task(run: ClusterRun, work: Callable[[Job], Result], index: int, job: Job) -> Result:
    """The result of a job. A worker that joined after the client's check is checked here."""
    worker = get_worker()
    wrong = unfitness(run.software, software(), worker.state.nthreads)
    if wrong:
        raise UnfitError(f"{worker.address}: {wrong}")
    with reporting_to(_Report(worker, run.id, index)):
        return work(job)


def unfitness(wanted: dict[str, str], found: dict[str, str], threads: int) -> str:
    """Why a worker must not run jobs, and what to do; "" where it may."""
    wrong = differences(wanted, found)
    if wrong:
        return f"{wrong}; make all machines alike (docs/cluster.md) and start its processes again"
    if threads != 1:
        return f"runs {threads} jobs in one process; start it with --nthreads 1, and --nworkers {threads} for its cores"
    return ""


class _Report:
    """Sends the progress of one job to the client, at most every REPORT_S, and ends the job when it is cancelled."""

    def __init__(self, worker: Worker, run_id: str, index: int) -> None:
        self._worker, self._key = worker, worker.get_current_task()
        self._run_id, self._index = run_id, index
        self._due_s = 0.0

    def __call__(self, share: float) -> None:
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        self._due_s = now_s + REPORT_S
        state = self._worker.state.tasks.get(self._key)
        if state is None or state.state == "cancelled":
            raise CancelledTaskError
        self._worker.log_event(TOPIC, (self._run_id, self._index, share))
