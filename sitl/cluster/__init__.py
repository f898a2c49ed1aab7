"""Runs the jobs of sitl/workers.py on many machines, with Dask. Importing this package does not import Dask."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec

from companion import how_to_install
from companion.types.errors import UnusableError
from sitl.workers import LocalWorkers, Workers


@contextmanager
def workers_of(address: str | None, processes: int | None = None) -> Iterator[Workers]:
    """The workers of the scheduler at this address; without one, processes of this machine.

    Raises UnusableError where the cluster cannot be used, before any job.
    """
    if address is None:
        yield LocalWorkers(processes)
        return
    if find_spec("distributed") is None:
        raise UnusableError(f"--cluster: distributed is not installed; {how_to_install('cluster')}")
    from sitl.cluster.client import connected

    with connected(address) as cluster:
        yield cluster
