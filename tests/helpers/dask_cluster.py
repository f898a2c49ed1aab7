"""A real Dask scheduler and workers on loopback, and jobs for them: workers import this module by its name."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from common import ROOT, until
from sitl.workers import report_progress


def square(x: int) -> int:
    return x * x


def fail(job: int) -> int:
    raise ValueError(f"job {job}")


def die(_job: int) -> int:
    os.kill(os.getpid(), signal.SIGKILL)
    return 0


def half(folder: Path) -> None:
    """Report half of the work until the job is cancelled; then write a file."""
    (folder / "begun").touch()
    try:
        while True:
            report_progress(0.5)
            time.sleep(0.05)
    finally:
        (folder / "ended").touch()


def once_killed(job: tuple[Path, int]) -> int:
    """The square of a number. The first attempt writes the process id to a file and waits there for its end."""
    folder, x = job
    file = folder / str(x)
    if not file.exists():
        file.with_suffix(".new").write_text(str(os.getpid()))
        file.with_suffix(".new").rename(file)
        time.sleep(60.0)
    return x * x


def known_tasks(dask_scheduler: Any) -> int:
    """Tasks that the scheduler has not forgotten."""
    return len(dask_scheduler.tasks)


def running_tasks(dask_worker: Any) -> int:
    return len(dask_worker.state.executing)


HELPERS = Path(__file__).parent
STARTS_WITHIN_S = 60.0


class Cluster:
    """The processes of one cluster. `folder` holds what they print."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder, self._stack = folder, stack
        self.workers: list[subprocess.Popen[bytes]] = []
        file = folder / "scheduler.json"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
        until(lambda: file.exists() and file.read_text().endswith("}"), STARTS_WITHIN_S)  # it is not written at once
        self.address: str = json.loads(file.read_text())["address"]

    def add_worker(self, *options: str) -> subprocess.Popen[bytes]:
        """Start a worker process without a nanny, which would start it again."""
        given = ("--nthreads", "1", *options)  # the last of two equal options counts
        self.workers.append(self._start("worker", self.address, "--no-nanny", "--host", "127.0.0.1", *given))
        return self.workers[-1]

    def _start(self, kind: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{kind}", "--no-dashboard", *arguments]
        path = os.pathsep.join([str(HELPERS), str(ROOT)])
        with (self._folder / f"{kind}_{len(self.workers)}.log").open("wb") as log:
            process = subprocess.Popen(
                command, cwd=self._folder, env=os.environ | {"PYTHONPATH": path}, stdout=log, stderr=log
            )
        self._stack.callback(_end_process, process)
        return process


@contextmanager
def cluster(folder: Path, workers: int) -> Iterator[Cluster]:
    with ExitStack() as stack:
        made = Cluster(folder, stack)
        for _ in range(workers):
            made.add_worker()
        yield made


def _end_process(process: subprocess.Popen[bytes]) -> None:
    process.kill()
    process.wait()
