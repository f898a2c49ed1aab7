"""`companion ... | head` and `sitl ... | head` end without a message when the pipe is closed."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from common import ROOT
from companion.cli.program import end_quietly

PLATOON = ROOT / "config" / "scenarios" / "platoon.yaml"


@pytest.mark.parametrize(
    "arguments",
    [
        ("companion", "analyze", PLATOON),
        ("sitl", "compare", PLATOON, "--seeds", "1", "--seconds", "4", "--quiet"),
    ],
)
def test_a_closed_pipe_is_no_traceback(arguments: tuple[object, ...], tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    more = ("--out", tmp_path) if "compare" in arguments else ()
    done = subprocess.run(
        [sys.executable, "-m", *map(str, (*arguments, *more))],
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
        check=False,
    )
    os.close(write)
    assert done.stderr == ""
    assert done.returncode == 141
    assert not more or (tmp_path / "compare.csv").exists()


def test_another_broken_pipe_is_an_error() -> None:
    with pytest.raises(BrokenPipeError), end_quietly():
        raise BrokenPipeError
