"""A program of the project, as a user starts it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def running(*arguments: str) -> Iterator[subprocess.Popen[str]]:
    """`python -m ARGUMENTS`, interrupted at the end. No COMPANION variable of this shell chooses its fleet."""
    command = [sys.executable, "-m", *arguments]
    environment = {key: value for key, value in os.environ.items() if not key.startswith("COMPANION")}
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.communicate(timeout=40.0)
        finally:
            process.kill()
