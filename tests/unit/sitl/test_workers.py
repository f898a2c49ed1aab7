"""Worker processes: results, errors, progress, and that no process is left behind."""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from multiprocessing.context import SpawnProcess
from pathlib import Path

import pytest

from sitl.workers import LocalWorkers, WorkerDiedError, all_results, report_progress

PARENT = """
import sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
from test_workers import hang
from sitl.workers import LocalWorkers
if __name__ == "__main__":
    with LocalWorkers(2).running(hang, [Path(sys.argv[2]) / "a", Path(sys.argv[2]) / "b"]) as in_progress:
        in_progress.results()
"""


def square(x: int) -> int:
    return x * x


def own_process(_job: int) -> int:
    return os.getpid()


def settings(_job: int) -> tuple[str, set[signal.Signals]]:
    return os.environ["OMP_NUM_THREADS"], set(signal.pthread_sigmask(signal.SIG_BLOCK, ()))


def fail(job: int) -> int:
    if job:
        raise ValueError(f"job {job}")
    return hang(Path(os.devnull))


def half(_job: int) -> None:
    report_progress(0.5)
    hang(Path(os.devnull))


def return_what_cannot_be_pickled(_job: int) -> Callable[[], int]:
    return lambda: 1


def hang(pid_file: Path) -> int:
    """Write the process id to a file, then sleep for ever."""
    if pid_file != Path(os.devnull):
        pid_file.with_suffix(".new").write_text(str(os.getpid()))
        pid_file.with_suffix(".new").rename(pid_file)
    while True:
        time.sleep(60.0)


def until(what: Callable[[], bool], seconds: float) -> None:
    end_s = time.monotonic() + seconds
    while not what():
        assert time.monotonic() < end_s
        time.sleep(0.02)


def is_alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def pids_in(*files: Path) -> list[int]:
    until(lambda: all(file.exists() for file in files), 20.0)
    return [int(file.read_text()) for file in files]


def test_results_are_in_the_order_of_the_jobs_for_any_weights() -> None:
    assert all_results(LocalWorkers(), square, [3, 4, 5], lambda _share: None) == [9, 16, 25]
    assert all_results(LocalWorkers(), square, [3, 4, 5], lambda _share: None, weights=[1.0, 3.0, 2.0]) == [9, 16, 25]


def test_no_jobs_give_no_results() -> None:
    assert all_results(LocalWorkers(), square, [], lambda _share: None) == []


def test_workers_are_processes_with_one_thread_that_ignore_ctrl_c() -> None:
    with LocalWorkers(1).running(own_process, [1, 2]) as in_progress:
        first, second = in_progress.results()
    assert first == second != os.getpid()
    ((threads, blocked),) = all_results(LocalWorkers(), settings, [1], lambda _share: None)
    assert threads == "1"
    assert blocked >= {signal.SIGINT, signal.SIGHUP}
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_error_of_a_job_is_raised_at_once_while_others_run() -> None:
    with pytest.raises(ValueError, match="job 7") as raised:
        all_results(LocalWorkers(2), fail, [0, 7], lambda _share: None)
    assert "in fail" in str(raised.value.__cause__)  # the traceback of the worker


def test_a_result_that_cannot_be_pickled_is_an_error() -> None:
    with pytest.raises(Exception, match="pickle"):
        all_results(LocalWorkers(), return_what_cannot_be_pickled, [1], lambda _share: None)


def test_a_job_reports_its_progress() -> None:
    with LocalWorkers(1).running(half, [1, 2], weights=[30.0, 10.0]) as in_progress:
        assert in_progress.share_done == 0.0
        until(lambda: in_progress.share_done > 0.0, 20.0)
        assert in_progress.share_done == 0.5 * 30.0 / 40.0
        assert in_progress.results_so_far() == [None, None]
        assert not in_progress.wait(0.0)
    report_progress(0.5)  # no effect outside a worker


def test_a_killed_worker_is_one_error(tmp_path: Path) -> None:
    with LocalWorkers(2).running(hang, [tmp_path / "a", tmp_path / "b"]) as in_progress:
        os.kill(pids_in(tmp_path / "a")[0], signal.SIGKILL)
        with pytest.raises(WorkerDiedError):
            in_progress.results()


def test_a_worker_that_started_slowly_and_was_killed_is_noticed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = SpawnProcess.start

    def start_slowly(process: SpawnProcess) -> None:
        time.sleep(0.5)  # as on a busy machine: the pool has looked at its workers before this one is among them
        start(process)

    monkeypatch.setattr(SpawnProcess, "start", start_slowly)
    with LocalWorkers(2).running(hang, [tmp_path / "a", tmp_path / "b"]) as in_progress:
        os.kill(max(pids_in(tmp_path / "a", tmp_path / "b")), signal.SIGKILL)
        assert in_progress.wait(20.0)
        with pytest.raises(WorkerDiedError):
            in_progress.results()


def test_leaving_the_block_early_ends_all_workers(tmp_path: Path) -> None:
    files = (tmp_path / "a", tmp_path / "b")
    with pytest.raises(KeyError), LocalWorkers(2).running(hang, [*files, tmp_path / "c"]):
        pids = pids_in(*files)
        raise KeyError  # the jobs would go on for ever
    assert not any(map(is_alive, pids))
    assert not (tmp_path / "c").exists()


def test_killing_the_parent_ends_the_workers(tmp_path: Path) -> None:
    parent = subprocess.Popen([sys.executable, "-c", PARENT, Path(__file__).parent, tmp_path])
    pids = pids_in(tmp_path / "a", tmp_path / "b")
    parent.kill()
    parent.wait()
    until(lambda: not any(map(is_alive, pids)), 2.0)


LARGE_JOBS = """
import sys
sys.path.insert(0, sys.argv[1])
from test_workers import sleep_with
from sitl.workers import LocalWorkers
if __name__ == "__main__":
    with LocalWorkers(1).running(sleep_with, [bytes(300_000)] * 6) as in_progress:
        in_progress.wait(1.0)
"""


def sleep_with(_job: bytes) -> None:
    time.sleep(600.0)


def test_jobs_that_no_pipe_can_hold_end_as_well(tmp_path: Path) -> None:
    script = tmp_path / "large_jobs.py"
    script.write_text(LARGE_JOBS)
    subprocess.run([sys.executable, str(script), str(Path(__file__).parent)], check=True, timeout=60.0)
