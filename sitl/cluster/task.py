"""One job as a task of Dask: what runs in a worker, what it reports, and what must agree for identical results.

Results depend on code, versions and arithmetic, which must be the same on all machines of a cluster.
"""

from __future__ import annotations

import math
import platform
import time
from collections.abc import Callable
from functools import cache
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import TypeVar

import numpy as np
from distributed import Worker, get_worker
from msgspec import Struct

import companion
import sitl
from companion.types.errors import CompanionError, UnusableError
from sitl.workers import reporting_to

PACKAGES = ("numpy", "scipy", "msgspec", "distributed")
DIGEST_DIGITS = 12
TOPIC = "sitl progress"  # one for all runs: the scheduler keeps the last events of every topic for ever
REPORT_S = 0.5


@cache
def software() -> dict[str, str]:
    """Name and version of everything on this machine that results depend on."""
    return {
        "formation-companion": companion.__version__,
        "its source files": _sources(),
        "Python": platform.python_version(),
        **{package: _version(package) for package in PACKAGES},
        "arithmetic": _arithmetic(),
    }


def differences(wanted: dict[str, str], found: dict[str, str]) -> str:
    """What differs, such as "numpy 1.26.4 (here 2.4.6)", with commas between; "" where nothing does."""
    return ", ".join(
        f"{name} {found.get(name, 'unknown')} (here {wanted[name]})"
        for name in wanted
        if found.get(name) != wanted[name]
    )


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _sources() -> str:
    """A digest: two checkouts of one version may hold different code."""
    digest = sha256()
    for package in (companion, sitl):
        assert package.__file__ is not None
        folder = Path(package.__file__).parent
        for file in sorted(folder.rglob("*.py")):
            digest.update(f"{folder.name}/{file.relative_to(folder)}\0".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:DIGEST_DIGITS]


def _arithmetic() -> str:
    """A digest of computed values: numpy and BLAS choose their loops by the processor, and the last bits differ."""
    x = np.linspace(-20.0, 20.0, 4001)
    matrix = np.sin(np.arange(64.0)).reshape(8, 8)
    computed = [
        *(function(x) for function in (np.sin, np.cos, np.exp, np.arctan, np.tanh)),
        *(np.log(x * x + 1.0), np.arctan2(x, x[::-1]), np.hypot(x, x[::-1]), np.power(x * x, 0.3)),
        *(matrix @ matrix, np.linalg.eigvalsh(matrix @ matrix.T), np.linalg.solve(matrix + 8.0 * np.eye(8), matrix)),
        np.array([function(value) for function in (math.sin, math.exp, math.atan) for value in x.tolist()]),
    ]
    return sha256(b"".join(values.tobytes() for values in computed)).hexdigest()[:DIGEST_DIGITS]


Job = TypeVar("Job")
Result = TypeVar("Result")


class UnfitError(UnusableError):
    """A machine of the cluster cannot give the results of this one. str() is one line that names it and what differs."""


class CancelledTaskError(CompanionError):
    """The client no longer wants the result of this task. No program sees this error."""


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
