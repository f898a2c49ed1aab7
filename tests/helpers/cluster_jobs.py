"""Jobs for the workers of a cluster, which import this module by its name."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

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
