"""Disk, root file system, kernel and Python."""

from __future__ import annotations

import re

from companion.tools.host.board import Board
from companion.tools.host.finding import HostFinding, ok, problem, unknown, warning

DISK, ROOT, KERNEL, PYTHON = "disk", "root file system", "kernel", "Python"
LITTLE_BYTES, LEAST_BYTES = 1_000_000_000, 100_000_000  # an upgrade needs 0.3 GB, the journal up to 0.2 GB
OLDEST_KERNEL = (5, 10)
OLDEST_PYTHON = (3, 11)
IN_MEMORY = ("overlay", "tmpfs", "aufs")


def disk(board: Board) -> HostFinding:
    """The free space of the root file system."""
    if board.free_bytes is None:
        return unknown(DISK, "the free space")
    found = f"{board.free_bytes / 1e9:.1f} GB free"
    if board.free_bytes < LEAST_BYTES:
        return problem(DISK, found, "remove files; sudo journalctl --vacuum-size=50M")
    if board.free_bytes < LITTLE_BYTES:
        return warning(DISK, found, "an upgrade of the package needs 0.3 GB beside the journal")
    return ok(DISK, found)


def root_file_system(board: Board) -> HostFinding:
    """Whether what is written stays: a card that is worn out becomes read-only, an overlay forgets."""
    mounts = [line.split() for line in (board.text("proc/mounts") or "").splitlines()]
    roots = [fields for fields in mounts if len(fields) >= 4 and fields[1] == "/"]
    if not roots:
        return unknown(ROOT, "how it is mounted")
    kind, options = roots[-1][2], roots[-1][3].split(",")
    if "ro" in options:
        text = "no log is kept and nothing can be installed: if this is not intended, check the card (dmesg)"
        return warning(ROOT, f"{kind}, read-only", text)
    if kind in IN_MEMORY:
        return warning(ROOT, f"{kind}, in memory", "what is written is lost with the supply: copy logs before")
    return ok(ROOT, f"{kind}, writable")


def kernel(board: Board) -> HostFinding:
    """The release of the kernel."""
    release = board.text("proc/sys/kernel/osrelease") or ""
    found = re.match(r"(\d+)\.(\d+)", release)
    if not found:
        return unknown(KERNEL, "its release")
    if (int(found[1]), int(found[2])) < OLDEST_KERNEL:
        wanted = ".".join(map(str, OLDEST_KERNEL))
        return warning(KERNEL, release, f"older than {wanted}, the oldest that Debian 11 has: upgrade the system")
    return ok(KERNEL, release)


def python(board: Board) -> HostFinding:
    """The version of Python that runs this check."""
    found = ".".join(map(str, board.python))
    if board.python < OLDEST_PYTHON:
        return problem(PYTHON, found, f"{'.'.join(map(str, OLDEST_PYTHON))} or newer is needed")
    return ok(PYTHON, found)
