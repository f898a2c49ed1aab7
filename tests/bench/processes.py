"""Processes of a measurement: their start and end, the talk with them, and what the kernel counts of them. Linux.

A program of tests/bench/programs prints a line when it is ready, measures from a line of its input on, and prints its result
as one line of JSON. Whatever starts here ends with the stack, and with this process, however it ends.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from threading import Timer
from typing import NamedTuple, TypeVar

import msgspec
import psutil

HEARD_WITHIN_S = 60.0
ENDS_WITHIN_S = 3.0
Decoded = TypeVar("Decoded")


def module(name: str, *arguments: str) -> list[str]:
    """The command that runs a module with this Python."""
    return [sys.executable, "-m", name, *arguments]


def start_silent(stack: ExitStack, command: Sequence[str]) -> None:
    """Start a process without input and output."""
    silent = subprocess.DEVNULL
    process = subprocess.Popen([*_bound(), *command], stdin=silent, stdout=silent, stderr=silent)
    stack.callback(_end, process)


class Program:
    """A running process, with its standard input and output."""

    def __init__(self, stack: ExitStack, command: Sequence[str], environment: Mapping[str, str] | None = None) -> None:
        self._command, pipe = command, subprocess.PIPE
        self._process = subprocess.Popen([*_bound(), *command], stdin=pipe, stdout=pipe, text=True, env=environment)
        stack.callback(_end, self._process)

    @property
    def pid(self) -> int:
        return self._process.pid

    def line(self) -> str:
        """The next line of its output. Raises RuntimeError where it has ended."""
        assert self._process.stdout is not None
        if not (line := self._process.stdout.readline()):
            raise RuntimeError(f"{' '.join(self._command)} has ended")
        return line

    def begin(self, what: str = "") -> None:
        """A line for its input."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.write(f"{what}\n")
            self._process.stdin.flush()

    def end_input(self) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()

    def result(self, kind: type[Decoded]) -> Decoded:
        """The next line of its output, decoded."""
        return msgspec.json.decode(self.line(), type=kind)

    def kill(self) -> None:
        self._process.kill()


def wait_for(programs: Sequence[Program], line: str, within_s: float = HEARD_WITHIN_S) -> None:
    """Wait until each has printed this line. Raises RuntimeError, and all are killed, where that takes longer."""

    def give_up() -> None:
        for program in programs:
            program.kill()

    limit = Timer(within_s, give_up)
    limit.start()
    try:
        for program in programs:
            if program.line() != f"{line}\n":
                raise RuntimeError("another line")
    except RuntimeError as error:
        raise RuntimeError(f"no {line!r} within {within_s:g} s") from error
    finally:
        limit.cancel()


def _bound() -> list[str]:
    return module("sitl.flight.bound", str(os.getpid()))


def _end(process: subprocess.Popen[str] | subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(ENDS_WITHIN_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    for stream in (process.stdin, process.stdout):
        if stream:
            stream.close()


class ProcessUse(NamedTuple):
    """Resident memory in MB, open files and threads of one process."""

    memory_mb: float
    files: int
    threads: int


def use_of(pid: int) -> ProcessUse:
    """Of a running process. Raises psutil.NoSuchProcess."""
    process = psutil.Process(pid)
    return ProcessUse(process.memory_info().rss / 1e6, process.num_fds(), process.num_threads())


def cpu_s(pid: int) -> float:
    """Time that all threads of a process have run, to the nanosecond: psutil has it in ticks of 10 ms."""
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return sum(int((task / "schedstat").read_text(encoding="ascii").split()[0]) for task in tasks) / 1e9


class CoreTime(NamedTuple):
    """Of all cores since the start of the machine, seconds; `stolen_s` was taken by the hypervisor."""

    all_s: float
    stolen_s: float


def core_time() -> CoreTime:
    times = psutil.cpu_times()
    return CoreTime(sum(times) - times.guest - times.guest_nice, times.steal)  # user time contains that of guests


def stolen_percent(before: CoreTime, after: CoreTime) -> float:
    """Share of the cores' time that the hypervisor took."""
    return 100.0 * (after.stolen_s - before.stolen_s) / max(0.01, after.all_s - before.all_s)


def others_cpu_s() -> float:
    """CPU time up to now of all processes but this one and those that it started, seconds.

    What ended in between counts with its parent. The time of all cores less the own would count interrupts too, by samples.
    """
    found = psutil.process_iter(["ppid", "cpu_times"])
    processes = {one.pid: (one.info["ppid"], sum(one.info["cpu_times"][:4])) for one in found if one.info["cpu_times"]}
    return used_by_others(os.getpid(), processes)


def used_by_others(own_id: int, processes: Mapping[int, tuple[int, float]]) -> float:
    """Sum over all processes that this one did not start. `processes`: parent and use of each."""

    def is_own(process_id: int) -> bool:
        while process_id != own_id:
            if process_id not in processes:
                return False
            process_id, _ = processes[process_id]
        return True

    return sum(used for process_id, (_, used) in processes.items() if not is_own(process_id))
