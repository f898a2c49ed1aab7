"""Files and folders that are complete or absent: written under another name beside it, then renamed."""

from __future__ import annotations

import os
from pathlib import Path

PRIVATE, PUBLIC = 0o600, 0o644
PART = ".part"  # suffix of what is not complete yet


def write_file(path: Path, content: bytes, mode: int = PUBLIC) -> None:
    """Writes a file under another name in its folder, then renames it. A file in its place is replaced. Raises OSError."""
    part = part_of(path)
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(part, flags, PRIVATE), "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        sync_folder(path.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


def part_of(path: Path) -> Path:
    """The name of a file or folder until it is complete."""
    return path.with_name(f".{path.name}.{os.getpid()}{PART}")


def sync_folder(folder: Path) -> None:
    """So that a name is on the disk, too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
