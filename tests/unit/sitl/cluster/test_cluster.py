"""Jobs on a real Dask scheduler with workers on loopback: results, progress, lost processes, and what cannot be used."""

import os
import signal
import socket
import subprocess
import sys
import time
from argparse import ArgumentTypeError
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from distributed import Client
from numpy.lib.introspect import opt_func_info

import dask_cluster as jobs
from common import until
from companion.types.errors import UnusableError
from dask_cluster import Cluster, cluster
from sitl.cli.options import cluster_address
from sitl.cluster import client as client_module
from sitl.cluster import workers_of
from sitl.cluster.client import DeadlyJobError, NoWorkersLeftError, SchedulerLostError
from sitl.cluster.task import UnfitError, differences, software, unfitness
from sitl.workers import LocalWorkers, all_results

OTHER_NUMPY = "from sitl.cluster import task\ntask.software()['numpy'] = '1.0'\n"


@pytest.fixture(autouse=True)
def sources_of_this_moment() -> None:
    """A working tree may be edited while its tests run."""
    software.cache_clear()


@pytest.fixture
def two(tmp_path: Path) -> Iterator[Cluster]:
    with cluster(tmp_path, 2) as made:
        yield made


@pytest.fixture
def silent() -> Iterator[str]:
    """The address of a program that accepts connections and says nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"


def no_progress(_share: float) -> None:
    pass


def test_results_are_those_of_local_processes_in_the_order_of_the_jobs(two: Cluster) -> None:
    with workers_of(two.address) as workers:
        for weights in ((), (1.0, 3.0, 2.0)):
            assert all_results(workers, jobs.square, [3, 4, 5], no_progress, weights) == [9, 16, 25]
        assert all_results(workers, jobs.square, [], no_progress) == []


def test_without_an_address_the_workers_are_local() -> None:
    with workers_of(None, 3) as workers:
        assert workers == LocalWorkers(3)


def test_without_dask_the_error_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    wanted = r"distributed is not installed; .* -m pip install '.*\[cluster\]'"
    with pytest.raises(UnusableError, match=wanted), workers_of("tcp://127.0.0.1:1"):
        pytest.fail("connected")


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("10.0.0.1:8786", "tcp://10.0.0.1:8786"),
        ("tls://big-machine.lab:8786", "tls://big-machine.lab:8786"),
        ("[fe80::1]:1", "tcp://[fe80::1]:1"),
    ],
)
def test_the_address_gets_its_protocol(text: str, address: str) -> None:
    assert cluster_address(text) == address


@pytest.mark.parametrize("text", ["10.0.0.1", "10.0.0.1:0", "10.0.0.1:70000", "http://a:1", "a:1/x", "", ":1"])
def test_a_wrong_address_is_refused(text: str) -> None:
    with pytest.raises(ArgumentTypeError, match="expected"):
        cluster_address(text)


def test_an_error_of_a_job_is_raised(two: Cluster) -> None:
    with workers_of(two.address) as workers, pytest.raises(ValueError, match="job 7"):
        all_results(workers, jobs.fail, [7], no_progress)


def test_progress_comes_from_the_workers_and_leaving_the_block_ends_the_jobs(two: Cluster, tmp_path: Path) -> None:
    with workers_of(two.address) as workers, workers.running(jobs.half, [tmp_path], [3.0]) as running:
        until(lambda: running.share_done > 0.0, 20.0)
        assert running.share_done == 0.5
        assert running.results_so_far() == [None]
        assert not running.wait(0.0)
        assert not (tmp_path / "ended").exists()
    until((tmp_path / "ended").exists, 20.0)


@pytest.mark.long
def test_jobs_of_a_killed_worker_are_repeated(two: Cluster, tmp_path: Path) -> None:
    folder = tmp_path / "jobs"
    folder.mkdir()
    with workers_of(two.address) as workers, workers.running(jobs.once_killed, [(folder, 3)]) as running:
        until((folder / "3").exists, 20.0)
        os.kill(int((folder / "3").read_text()), signal.SIGKILL)
        assert running.results() == [9]


@pytest.mark.long
def test_a_job_that_ends_every_worker_is_one_error(two: Cluster) -> None:
    def replace_dead() -> None:
        for _ in range(2):
            count = len(two.workers)
            until(lambda count=count: sum(w.poll() is not None for w in two.workers) > count - 2, 60.0)
            two.add_worker()

    with ThreadPoolExecutor(1) as thread, workers_of(two.address) as workers:
        replaced = thread.submit(replace_dead)
        with pytest.raises(DeadlyJobError, match="a job ended 4 worker processes, the last at tcp"):
            all_results(workers, jobs.die, [1], no_progress)
        replaced.result()


@pytest.mark.long
def test_when_no_worker_is_left_the_wait_ends(two: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "LOOK_S", 0.2)
    with workers_of(two.address) as workers, workers.running(jobs.half, [tmp_path]) as running:
        monkeypatch.setattr(client_module, "WORKERS_WITHIN_S", 1.0)
        until((tmp_path / "begun").exists, 20.0)
        for worker in two.workers:
            worker.kill()
        with pytest.raises(NoWorkersLeftError, match="are gone since 1 s; start some with `dask worker tcp://"):
            running.results()


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP])
def test_a_scheduler_that_ends_or_hangs_ends_the_wait(
    number: signal.Signals, two: Cluster, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "LOOK_S", 0.2)
    with pytest.raises(SchedulerLostError, match=two.address), workers_of(two.address) as workers:
        monkeypatch.setattr(client_module, "ANSWERS_WITHIN_S", 1.0)
        with workers.running(jobs.half, [tmp_path]) as running:
            until((tmp_path / "begun").exists, 20.0)
            two.scheduler.send_signal(number)
            began_s = time.monotonic()
            running.results()
    assert time.monotonic() - began_s < 10.0


def test_a_scheduler_that_is_away_is_one_line_in_bounded_time(
    silent: str, two: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(client_module, "ANSWERS_WITHIN_S", 1.0)
    began_s = time.monotonic()
    for address in ("tcp://127.0.0.1:1", silent, "tls://127.0.0.1:1"):
        with pytest.raises(UnusableError) as raised, workers_of(address):
            pytest.fail("connected")
        assert str(raised.value).startswith(f"no Dask scheduler answers at {address}; start one there with `dask sche")
        assert "\n" not in str(raised.value)
    with Client(two.address, set_as_default=False) as client:
        client.wait_for_workers(1, timeout=60)
        worker = next(iter(client.nthreads()))
    with pytest.raises(UnusableError, match=f"{worker} is no Dask scheduler but a Worker"), workers_of(worker):
        pytest.fail("connected")
    assert time.monotonic() - began_s < 15.0


def test_a_cluster_without_workers_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_module, "WORKERS_WITHIN_S", 0.5)
    with (
        cluster(tmp_path, 0) as made,
        pytest.raises(UnusableError, match="has no workers; start some with `dask worker tcp://"),
        workers_of(made.address),
    ):
        pytest.fail("connected")


def preload(folder: Path) -> tuple[str, str]:
    """Options of a worker that has another numpy."""
    file = folder / "other_numpy.py"
    file.write_text(OTHER_NUMPY)
    return "--preload", str(file)


def test_a_worker_with_another_version_is_refused_before_any_job(tmp_path: Path) -> None:
    with cluster(tmp_path, 0) as made:
        made.add_worker(*preload(tmp_path))
        with pytest.raises(UnfitError) as raised, workers_of(made.address):
            pytest.fail("connected")
    here = software()["numpy"]
    assert str(raised.value).startswith("tcp://127.0.0.1:")
    assert f": numpy 1.0 (here {here}); make all machines alike (docs/cluster.md)" in str(raised.value)


@pytest.mark.long
def test_a_worker_that_joins_later_with_another_version_is_refused_too(tmp_path: Path) -> None:
    with cluster(tmp_path, 1) as made, workers_of(made.address) as workers:
        made.add_worker(*preload(tmp_path))
        until(lambda: len(workers.client.nthreads()) == 2, 60.0)  # type: ignore[attr-defined]
        made.workers[0].kill()
        with pytest.raises(UnfitError, match=r"numpy 1\.0 \(here"):
            all_results(workers, jobs.square, [1], no_progress)


def test_a_worker_with_threads_is_refused(tmp_path: Path) -> None:
    with cluster(tmp_path, 0) as made:
        made.add_worker("--nthreads", "3")
        reason = "runs 3 jobs in one process; start it with --nthreads 1"
        with pytest.raises(UnfitError, match=reason), workers_of(made.address):
            pytest.fail("connected")


@pytest.mark.skipif("X86_V4" not in opt_func_info(func_name="^sin$")["sin"]["dd"]["current"], reason="needs AVX-512")
def test_another_instruction_set_is_another_arithmetic() -> None:
    code = "from sitl.cluster.task import software; print(software()['arithmetic'])"
    for disabled, same in (("", True), ("X86_V4", False)):
        environment = os.environ | {"NPY_DISABLE_CPU_FEATURES": disabled}
        printed = subprocess.check_output([sys.executable, "-c", code], env=environment, text=True)
        assert (printed.strip() == software()["arithmetic"]) is same


def test_differences_name_all_that_differs() -> None:
    wanted = {"Python": "3.11.7", "numpy": "2.4.6", "its source files": "ab"}
    assert differences(wanted, wanted) == unfitness(wanted, wanted, 1) == ""
    assert differences(wanted, {"Python": "3.12.1", "numpy": "2.4.6"}) == (
        "Python 3.12.1 (here 3.11.7), its source files unknown (here ab)"
    )
