"""The library of the laboratory: programs and the talk with them, and what the kernel counts of processes."""

from __future__ import annotations

import os
import sys
import tempfile
import threading
import time
from contextlib import ExitStack

import psutil
import pytest

from tests.bench.machine import Meanwhile
from tests.bench.processes import CoreTime, Program, core_time, cpu_s, start_silent, stolen_percent, use_of, wait_for

pytestmark = pytest.mark.long

TALKS = "import sys; print('heard', flush=True); sys.stdin.readline(); print('[1, 2]', flush=True); sys.stdin.read()"


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_use_of_a_process_counts_its_files_and_threads() -> None:
    before = use_of(os.getpid())
    stop = threading.Event()
    thread = threading.Thread(target=stop.wait)
    thread.start()
    with tempfile.TemporaryFile():
        during = use_of(os.getpid())
    stop.set()
    thread.join()
    assert (during.files, during.threads) == (before.files + 1, before.threads + 1)
    assert during.memory_mb > 1.0


def test_a_program_is_ready_begins_and_gives_its_result() -> None:
    with ExitStack() as stack:
        programs = [Program(stack, python(TALKS)) for _ in range(2)]
        wait_for(programs, "heard")
        for program in programs:
            program.begin()
        assert [program.result(list[int]) for program in programs] == [[1, 2], [1, 2]]
    assert not any(psutil.pid_exists(program.pid) for program in programs)


def test_programs_that_are_not_ready_in_time_are_ended() -> None:
    with ExitStack() as stack:
        programs = [Program(stack, python(TALKS)), Program(stack, python("import time; time.sleep(60)"))]
        with pytest.raises(RuntimeError, match="no 'heard' within 1 s"):
            wait_for(programs, "heard", 1.0)
        with pytest.raises(RuntimeError, match="has ended"):
            programs[0].line()


def test_what_started_silently_ends_with_the_stack() -> None:
    before = set(psutil.Process().children())
    with ExitStack() as stack:
        start_silent(stack, python("import time; time.sleep(60)"))
        (child,) = set(psutil.Process().children()) - before
    assert not child.is_running()


def test_cpu_time_grows_with_work_alone() -> None:
    before_s, until_s = cpu_s(os.getpid()), time.process_time() + 0.4
    while time.process_time() < until_s:
        pass
    worked_s = cpu_s(os.getpid())
    time.sleep(0.4)
    assert 0.2 < worked_s - before_s < 1.0
    assert cpu_s(os.getpid()) - worked_s < 0.2


def test_others_are_not_this_process() -> None:
    meanwhile, until_s = Meanwhile(), time.process_time() + 0.3
    while time.process_time() < until_s:
        pass
    assert 0.0 <= meanwhile.others_cores() < (os.cpu_count() or 1)
    assert meanwhile.machine().cores >= 1


def test_time_of_all_cores_advances() -> None:
    before = core_time()
    time.sleep(0.2)
    assert core_time().all_s > before.all_s
    assert stolen_percent(before, CoreTime(before.all_s + 1.0, before.stolen_s + 0.5)) == pytest.approx(50.0)
