"""Processes of a flight: how their end is reported, how they are stopped, and commands that end with their parent."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from sitl.flight.processes import Child, FleetProcesses


def child(tmp_path: Path, name: str, code: str) -> Child:
    log = tmp_path / f"{name}.log"
    with log.open("wb") as output:
        process = subprocess.Popen(
            [sys.executable, "-m", "sitl.flight.bound", str(os.getpid()), sys.executable, "-c", code],
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    return Child(name, (int(name.split()[-1]),), log, process)


SLEEP = "import time; print('here', flush=True); time.sleep(60)"
DEAF = "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); print('here', flush=True); time.sleep(60)"


def until_it_runs(*children: Child) -> None:
    deadline_s = time.monotonic() + 10.0
    while any(child.last_output() != "here" for child in children):
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_an_unexpected_end_is_reported_once_with_the_last_output(tmp_path: Path) -> None:
    ends = child(tmp_path, "agent 2", "import sys; print('a reason'); print(); sys.exit(3)")
    runs = child(tmp_path, "agent 1", SLEEP)
    with FleetProcesses([ends, runs]) as fleet:
        ends.process.wait()
        until_it_runs(runs)
        assert fleet.unexpected_end() == f"agent 2 ended with exit code 3: a reason; log: {ends.log}"
        assert fleet.unexpected_end() is None
        assert fleet.lost_vehicles() == fleet.ended_by_themselves() == {2}
        assert fleet.stop() == []
    assert runs.process.returncode == -signal.SIGTERM


def test_a_process_that_ignores_sigterm_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sitl.flight.processes.STAND_IN_ENDS_WITHIN_S", 0.3)
    deaf = child(tmp_path, "autopilot 1", DEAF)
    until_it_runs(deaf)
    with FleetProcesses([deaf]) as fleet:
        assert fleet.stop() == ["autopilot 1"]
    assert deaf.process.returncode == -signal.SIGKILL


def test_no_process_is_left_after_the_block(tmp_path: Path) -> None:
    runs = child(tmp_path, "agent 1", SLEEP)
    until_it_runs(runs)
    with pytest.raises(KeyboardInterrupt), FleetProcesses([runs]):
        raise KeyboardInterrupt
    assert runs.process.returncode == -signal.SIGKILL


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux signals the end of the parent")
def test_a_bound_command_ends_with_its_parent() -> None:
    parent_code = (
        "import os, subprocess, sys, time\n"
        f"command = [sys.executable, '-c', {SLEEP!r}]\n"
        "child = subprocess.Popen([sys.executable, '-m', 'sitl.flight.bound', str(os.getpid()), *command])\n"
        "print(child.pid, flush=True)\n"
        "time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", parent_code], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child_pid = int(parent.stdout.readline())
        assert parent.stdout.readline() == "here\n"
        parent.kill()
    deadline_s = time.monotonic() + 5.0
    while Path(f"/proc/{child_pid}").exists() and "Z" not in Path(f"/proc/{child_pid}/stat").read_text().split()[2]:
        assert time.monotonic() < deadline_s
        time.sleep(0.02)


def test_a_bound_command_does_not_start_without_its_parent() -> None:
    done = subprocess.run([sys.executable, "-m", "sitl.flight.bound", "1", "touch", "/never"], timeout=10, check=False)
    assert done.returncode == 1


def test_a_bound_command_that_does_not_exist_is_reported() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sitl.flight.bound", str(os.getpid()), "no-such-command"],
        capture_output=True,
        text=True,
        timeout=10,
        check=False,
    )
    assert done.returncode == 1
    assert done.stderr == "no-such-command: No such file or directory\n"


def test_the_end_of_a_killed_process_does_not_quote_a_line_that_has_nothing_to_do_with_it(tmp_path: Path) -> None:
    killed = child(tmp_path, "agent 3", SLEEP)
    until_it_runs(killed)
    os.killpg(killed.process.pid, signal.SIGKILL)
    killed.process.wait()
    assert killed.ending() == f"agent 3 was killed by SIGKILL; log: {killed.log}"
