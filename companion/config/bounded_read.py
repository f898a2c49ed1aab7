"""Reads files that are named by a user or another file: regular ones only, of limited size."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path

MAX_BYTES = 128 * 1024  # a fleet of 250 vehicles has 20 kB


def read_regular(path: Path, most_bytes: int = MAX_BYTES) -> tuple[bytes, os.stat_result]:
    """The content and state of a file. Raises OSError, also for a device, pipe or folder and for a larger file.

    O_NONBLOCK: opening a named pipe would otherwise wait for its writer.
    """
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    try:
        state = os.fstat(descriptor)
        if stat.S_ISDIR(state.st_mode):
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(state.st_mode):
            raise OSError(errno.EINVAL, "not a regular file")
        content = b""
        while len(content) <= most_bytes and (chunk := os.read(descriptor, most_bytes + 1 - len(content))):
            content += chunk
        if len(content) > most_bytes:
            raise OSError(errno.EFBIG, f"larger than {most_bytes // 1024} kB")
    finally:
        os.close(descriptor)
    return content, state
