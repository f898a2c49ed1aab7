"""Processes of a measurement: what the kernel counts of them. Linux."""

from __future__ import annotations

import resource
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Use:
    """Resident memory in MB, open files and threads of one process."""

    memory_mb: float
    files: int
    threads: int


def use_of(pid: int) -> Use:
    """Of a running process. Raises OSError."""
    folder = Path(f"/proc/{pid}")
    pages = int((folder / "statm").read_text(encoding="ascii").split()[1])
    return Use(
        memory_mb=pages * resource.getpagesize() / 1e6,
        files=len(list((folder / "fd").iterdir())),
        threads=len(list((folder / "task").iterdir())),
    )
