"""Files and folders that are complete or absent, with permissions that do not depend on the umask."""

from __future__ import annotations

import fcntl
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from companion.config.file import ConfigError

PRIVATE, PUBLIC = 0o600, 0o644
PRIVATE_FOLDER, PUBLIC_FOLDER = 0o700, 0o755
PART = ".part"  # suffix of what is not complete yet


def write_file(path: Path, content: bytes, mode: int = PUBLIC) -> None:
    """Writes a file under another name in its folder, then renames it. A file in its place is replaced. Raises OSError."""
    part = _part(path)
    try:
        flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(part, flags, PRIVATE), "wb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        part.replace(path)
        _sync(path.parent)
    except BaseException:
        part.unlink(missing_ok=True)
        raise


@contextmanager
def new_folder(path: Path, mode: int = PRIVATE_FOLDER) -> Iterator[Path]:
    """A folder under another name, which gets its name when it is complete. Nothing is left of it after an exception."""
    part = _part(path)
    try:
        make_folder(part, mode)
        yield part
        _sync(part)
        part.rename(path)
        _sync(path.parent)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise


def make_folder(path: Path, mode: int = PRIVATE_FOLDER) -> None:
    """A folder, for its owner alone without a `mode`. Raises OSError where it exists."""
    path.mkdir(PRIVATE_FOLDER)
    path.chmod(mode)


def remove_parts(folder: Path) -> None:
    """Removes what a run that was killed left under other names."""
    for part in folder.glob(f".*{PART}"):
        shutil.rmtree(part) if part.is_dir() else part.unlink()


@contextmanager
def one_at_a_time(folder: Path) -> Iterator[None]:
    """Only one process at a time is in here for a folder. Raises ConfigError for the second one, and for any OSError."""
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    except OSError as error:
        raise ConfigError(folder, "", f"{error.strerror}; check the path") from error
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    except BlockingIOError as error:
        raise ConfigError(folder, "", "another companion provision is at work here; wait until it has ended") from error
    except OSError as error:
        problem = f"{error.strerror}; then run the same command again, it completes what is missing"
        raise ConfigError(error.filename or folder, "", problem) from error
    finally:
        os.close(descriptor)


def _part(path: Path) -> Path:
    return path.with_name(f".{path.name}.{os.getpid()}{PART}")


def _sync(folder: Path) -> None:
    """So that a name is on the disk, too."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
