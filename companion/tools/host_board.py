"""A companion computer as the checks see it: files below a root, and the outputs of a few programs."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path

MOST_BYTES = 65536  # most bytes read of one file; all are far shorter
PROGRAM_S = 3.0
PROGRAMS = {  # by the name under which the checks find the output
    "timedatectl": ("timedatectl", "show", "--property=NTPSynchronized", "--value"),
    "get_throttled": ("vcgencmd", "get_throttled"),
    "agents": (
        *("systemctl", "show", "companion@*.service", "--property"),
        "Id,Nice,CPUSchedulingPolicy,CPUSchedulingPriority,CPUAffinity,TimerSlackNSec",
    ),
}
POWER_SAVE = "power_save "  # and the name of a Wi-Fi interface


@dataclass(frozen=True, slots=True)
class Board:
    """What the checks may know. `device` and `speed_baud`: the autopilot's serial port, where the vehicle file names one."""

    root: Path
    outputs: Mapping[str, str] = field(default_factory=dict)
    free_bytes: int | None = None
    python: tuple[int, int] = (0, 0)
    device: str = ""
    speed_baud: int = 0

    def text(self, path: str) -> str | None:
        """The text of a file below the root, without the space around it; None where it cannot be read."""
        try:
            with (self.root / path).open("rb") as file:
                return file.read(MOST_BYTES).decode("utf-8", "replace").strip()
        except OSError:
            return None

    def number(self, path: str) -> int | None:
        """The whole number in a file; None where there is none."""
        try:
            return int(self.text(path) or "")
        except ValueError:
            return None

    def paths(self, pattern: str) -> list[str]:
        """The paths that match, relative to the root and sorted."""
        return sorted(str(path.relative_to(self.root)) for path in self.root.glob(pattern))

    def target(self, path: str) -> str:
        """The last name of the target of a link; empty where there is no link."""
        try:
            return (self.root / path).readlink().name
        except OSError:
            return ""

    @property
    def model(self) -> str:
        """The board's name in the device tree, such as "Raspberry Pi 5 Model B Rev 1.0"."""
        return (self.text("proc/device-tree/model") or "").rstrip("\0")

    @property
    def is_raspberry_pi(self) -> bool:
        return self.model.startswith("Raspberry Pi")


def this_board(device: str = "", speed_baud: int = 0) -> Board:
    """The computer that this process runs on."""
    root = Path("/")
    wireless = [path.name for path in (root / "sys/class/net").glob("*") if (path / "wireless").exists()]
    programs = PROGRAMS | {POWER_SAVE + name: ("iw", "dev", name, "get", "power_save") for name in wireless}
    outputs = {name: output for name, command in programs.items() if (output := _output(command)) is not None}
    state = os.statvfs(root)
    return Board(root, outputs, state.f_bavail * state.f_frsize, sys.version_info[:2], device, speed_baud)


def _output(command: tuple[str, ...]) -> str | None:
    """The output of a program; None where it is missing or fails."""
    search = os.environ.get("PATH", "") + ":/usr/sbin:/sbin"  # where iw is
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=PROGRAM_S,
            check=True,
            env={**os.environ, "PATH": search, "LC_ALL": "C"},
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


class HostVerdict(StrEnum):
    """How a finding is judged. Missing information is never a problem."""

    OK = "ok"
    UNKNOWN = "not known"
    WARNING = "warning"
    PROBLEM = "problem"


@dataclass(frozen=True, slots=True)
class HostFinding:
    """One line of the report: what was checked, what was found, and what to do about it."""

    subject: str
    verdict: HostVerdict
    found: str
    remedy: str = ""


def ok(subject: str, found: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.OK, found)


def unknown(subject: str, found: str, remedy: str = "") -> HostFinding:
    return HostFinding(subject, HostVerdict.UNKNOWN, found, remedy)


def warning(subject: str, found: str, remedy: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.WARNING, found, remedy)


def problem(subject: str, found: str, remedy: str) -> HostFinding:
    return HostFinding(subject, HostVerdict.PROBLEM, found, remedy)
