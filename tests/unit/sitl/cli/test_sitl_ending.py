"""How a command of `sitl` ends: one line and an exit code for what a user can cause."""

import errno
import os
import signal
from pathlib import Path
from typing import NoReturn

import pytest

from companion.config.file import ConfigError
from sitl.cli.main import exit_code_of
from sitl.links.free_ports import PortInUseError
from sitl.paper.flights import NoFormationError
from sitl.stopping import StopNow, StopRequest
from sitl.workers import WorkerDiedError

NO_FOLDER = FileExistsError(errno.EEXIST, "File exists", "runs/x")
DISK_FULL = OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize(
    ("error", "exit_code", "line"),
    [
        (NoFormationError("platoon: arm not done"), 1, "platoon: arm not done"),
        (WorkerDiedError(), 1, str(WorkerDiedError())),
        (PortInUseError("UDP port 1, wanted by agent 2"), 2, "UDP port 1, wanted by agent 2"),
        (ConfigError("a.yaml", "law", "unknown key"), 2, "a.yaml: law: unknown key"),
        (NO_FOLDER, 2, "runs/x: File exists; choose another folder with --out"),
        (DISK_FULL, 2, "No space left on device; choose another folder with --out"),
        (StopNow("stopped; nothing was flown", 143), 143, "stopped; nothing was flown"),
    ],
)
def test_errors_that_a_user_can_cause_are_one_line(
    error: BaseException, exit_code: int, line: str, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails() -> NoReturn:
        raise error

    assert exit_code_of("sitl run", fails) == exit_code
    assert capsys.readouterr() == ("", line + "\n")


def test_nothing_is_printed_when_a_command_ends_normally(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code_of("sitl run", lambda: 1) == 1
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("error", [BrokenPipeError(errno.EPIPE, "Broken pipe"), ValueError("a mistake of ours")])
def test_other_errors_are_raised(error: Exception) -> None:
    def fails() -> NoReturn:
        raise error

    with pytest.raises(type(error)):
        exit_code_of("sitl run", fails)


def test_the_text_of_the_stop_request_is_printed_on_a_signal(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def works() -> int:
        with StopRequest(f"stopped; nothing is in {tmp_path}", at_once=True):
            os.kill(os.getpid(), signal.SIGTERM)
            signal.pause()
        return 0

    assert exit_code_of("sitl run", works) == 128 + signal.SIGTERM
    assert capsys.readouterr().err == f"stopped; nothing is in {tmp_path}\n"
