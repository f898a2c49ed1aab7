"""The connection to a Dask scheduler, and jobs that run on its workers."""

from __future__ import annotations

import asyncio
import logging
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from uuid import uuid4

from distributed import Client, KilledWorker, Security
from distributed.core import rpc

from companion.types.errors import FailedError, UnusableError
from sitl.cluster.task import TOPIC, ClusterRun, UnfitError, software, task, unfitness
from sitl.workers import Job, Result, RunningJobs, heaviest_first

ANSWERS_WITHIN_S = 10.0  # a scheduler
WORKERS_WITHIN_S = 30.0  # a nanny starts a lost worker process again within a few seconds
LOOK_S = 2.0  # period in which the scheduler is asked for its workers
CLOSES_WITHIN_S = 2.0
_TO_DO = "start one there with `dask scheduler`, or correct --cluster"


class SchedulerLostError(FailedError):
    """The scheduler ended, or no longer answers."""


class NoWorkersLeftError(FailedError):
    """All workers are gone and none came back."""


class DeadlyJobError(FailedError):
    """A job ended every worker process that it was given to."""


@contextmanager
def connected(address: str) -> Iterator[ClusterWorkers]:
    """The workers of the scheduler at this address, all with the software of this machine. Raises UnusableError."""
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # Dask sets it by itself
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", module="distributed"
        )  # of versions, which are compared here, and of large jobs
        client = _client(address)
        try:
            _check(client, address)
            yield ClusterWorkers(client, address)
        finally:
            _close(client)


@dataclass(frozen=True, slots=True)
class ClusterWorkers:
    """Worker processes of a Dask scheduler, which repeats the jobs of a lost worker."""

    client: Client
    address: str

    @contextmanager
    def running(
        self, work: Callable[[Job], Result], jobs: Sequence[Job], weights: Sequence[float] = ()
    ) -> Iterator[RunningJobs[Result]]:
        """See sitl.workers.Workers. Raises the errors of this module while jobs are waited for."""
        run = ClusterRun(uuid4().hex, software())
        weights = weights or [1.0] * len(jobs)
        shares = [0.0] * len(jobs)
        executor = self.client.get_executor(pure=False)
        self.client.subscribe_topic(TOPIC, _Shares(run.id, shares))
        try:
            futures = {index: executor.submit(task, run, work, index, jobs[index]) for index in heaviest_first(weights)}
            watch = _Watch(self.client, self.address)
            yield RunningJobs([futures[index] for index in range(len(jobs))], weights, shares, watch.look)
        except KilledWorker as error:
            raise DeadlyJobError(
                f"a job ended {error.allowed_failures + 1} worker processes, the last at {error.last_worker.address}, "
                "most likely for lack of memory; give each worker more with --memory-limit, or ask for less"
            ) from error
        except CancelledError as error:
            raise _lost(self.address) from error
        finally:
            if self.client.status == "running":
                self.client.unsubscribe_topic(TOPIC)
                executor.shutdown(wait=False)  # cancels what is not done


class _Shares:
    """Enters the progress of one run, as its workers report it, into `shares`."""

    def __init__(self, run_id: str, shares: list[float]) -> None:
        self._run_id, self._shares = run_id, shares

    def __call__(self, event: tuple[float, tuple[str, int, float]]) -> None:
        _, (run_id, index, share) = event
        if run_id == self._run_id:
            self._shares[index] = share


class _Watch:
    """Notices that jobs can no longer end."""

    def __init__(self, client: Client, address: str) -> None:
        self._client, self._address = client, address
        self._due_s, self._seen_s = 0.0, time.monotonic()

    def look(self) -> None:
        """Raise where the scheduler is lost, or all workers are gone for WORKERS_WITHIN_S."""
        if self._client.status != "running":
            raise _lost(self._address)
        now_s = time.monotonic()
        if now_s < self._due_s:
            return
        self._due_s = now_s + LOOK_S
        if _threads(self._client, self._address):
            self._seen_s = now_s
        elif now_s - self._seen_s > WORKERS_WITHIN_S:
            raise NoWorkersLeftError(
                f"all workers of {self._address} are gone since {WORKERS_WITHIN_S:g} s; {_start(self._address)}, and "
                "begin again"
            )


def _client(address: str) -> Client:
    """Connect. Raises UnusableError within ANSWERS_WITHIN_S where no scheduler answers, whatever else may listen there."""
    try:
        kind = asyncio.run(_kind_of(address))
    except Exception as error:
        raise UnusableError(f"no Dask scheduler answers at {address}; {_TO_DO} ({_one_line(error)})") from error
    if kind != "Scheduler":
        raise UnusableError(f"{address} is no Dask scheduler but a {kind}; {_TO_DO}")
    return Client(address, timeout=ANSWERS_WITHIN_S, set_as_default=False)


async def _kind_of(address: str) -> str:
    """What serves this address, by its own words. Client() alone would wait for ever for a program that says nothing."""
    arguments = Security().get_connection_args("client")
    async with asyncio.timeout(ANSWERS_WITHIN_S):
        async with rpc(address, timeout=ANSWERS_WITHIN_S, connection_args=arguments) as server:
            return str((await server.identity())["type"])


def _check(client: Client, address: str) -> None:
    """Raise UnfitError where the scheduler or a worker differs from this machine, UnusableError without workers."""
    threads = _first_workers(client, address)
    found = {"scheduler": _of_scheduler(client), **client.run(software, on_error="return")}
    unfit = {place: _why_unfit(of_place, threads.get(place, 1)) for place, of_place in found.items()}
    lines = [f"{place}: {why}" for place, why in unfit.items() if why]
    if lines:
        more = f" ({len(lines) - 1} more processes of the cluster are unfit)" if len(lines) > 1 else ""
        raise UnfitError(f"{lines[0]}{more}")


def _of_scheduler(client: Client) -> dict[str, str] | Exception:
    try:
        found: dict[str, str] = client.run_on_scheduler(software, callback_timeout=ANSWERS_WITHIN_S)
    except ImportError as error:
        return error
    return found


def _why_unfit(found: dict[str, str] | Exception, threads: int) -> str:
    if isinstance(found, Exception):  # it could not even import the function that was to be run
        return f"has not this project, or another version of it: {_one_line(found)}; install the same on all machines"
    return unfitness(software(), found, threads)


def _first_workers(client: Client, address: str) -> dict[str, int]:
    """Threads of each worker, as soon as there is one. Raises UnusableError after WORKERS_WITHIN_S."""
    end_s = time.monotonic() + WORKERS_WITHIN_S
    while not (threads := _threads(client, address)):
        if time.monotonic() > end_s:
            raise UnusableError(f"the scheduler {address} has no workers; {_start(address)}")
        time.sleep(0.2)
    return threads


def _threads(client: Client, address: str) -> dict[str, int]:
    """Threads of each worker. Raises SchedulerLostError."""
    try:
        threads: dict[str, int] = client.nthreads(callback_timeout=ANSWERS_WITHIN_S)
    except OSError as error:  # also TimeoutError
        raise _lost(address) from error
    return threads


def _lost(address: str) -> SchedulerLostError:
    return SchedulerLostError(f"the scheduler {address} ended or no longer answers; start it again, and begin again")


def _start(address: str) -> str:
    return f"start some with `dask worker {address} --nthreads 1 --nworkers CORES`"


def _close(client: Client) -> None:
    """Close the connection, by which the scheduler forgets all jobs. A scheduler that is lost cannot hold it up."""
    with suppress(TimeoutError):
        client.close(timeout=CLOSES_WITHIN_S)


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
