"""A Debian root that systemd boots in a container of its own, and commands in it."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

SUITE = "bookworm"
PACKAGES = "systemd-sysv,dbus,udev,adduser,python3-venv"  # of a board's system; the companion's package needs no more
BOOT_WITHIN_S = 60.0
STOP_WITHIN_S = 60.0
COMMAND_WITHIN_S = 300.0
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"


class BootError(Exception):
    """A step that the others depend on failed. `str()` says which, and what it printed."""


def bare_root(folder: Path) -> Path:
    """A Debian root with systemd, made once and kept."""
    root = folder / "root"
    if not (folder / "root.ready").exists():
        shutil.rmtree(root, ignore_errors=True)
        command = ["debootstrap", "--variant=minbase", f"--include={PACKAGES}", SUITE, str(root)]
        with (folder / "debootstrap.log").open("wb") as log:
            if subprocess.run(command, stdout=log, stderr=log, check=False).returncode != 0:
                raise BootError(f"debootstrap failed: {folder / 'debootstrap.log'}")
        (folder / "root.ready").touch()
    return root


class Machine:
    """A copy of a root, booted by systemd-nspawn. It has a network of its own, without any way out."""

    def __init__(self, bare: Path, folder: Path) -> None:
        self.root = folder / "machine"
        self._console = folder / "console.log"
        shutil.rmtree(self.root, ignore_errors=True)
        subprocess.run(["cp", "--archive", "--reflink=auto", str(bare), str(self.root)], check=True)
        (self.root / "etc" / "machine-id").write_text("", encoding="ascii")  # the first boot of a board
        self._process: subprocess.Popen[bytes] | None = None
        self._leader = 0

    def boot(self) -> None:
        """Start systemd and wait until it has started everything. Raises BootError."""
        command = ["systemd-nspawn", "--quiet", "--boot", f"--directory={self.root}", "--machine=companion-boot"]
        command += ["--register=no", "--keep-unit", "--private-network", "--link-journal=no", "--console=pipe"]
        with self._console.open("wb") as log:
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
        self._leader = self._wait_for_leader(self._process)
        until(
            lambda: self.run("systemctl", "is-system-running").stdout.strip() in ("running", "degraded"), BOOT_WITHIN_S
        )

    def _wait_for_leader(self, process: subprocess.Popen[bytes]) -> int:
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children")
        systemd_runs = "systemd"

        def leader() -> int:
            if process.poll() is not None:
                raise BootError(f"systemd-nspawn ended: {self._console}")
            for pid in children.read_text(encoding="ascii").split():
                if Path(f"/proc/{pid}/comm").read_text(encoding="ascii").strip() == systemd_runs:
                    return int(pid)
            return 0

        until(leader, BOOT_WITHIN_S)
        return leader()

    def run(self, *command: str, stdin: str = "") -> subprocess.CompletedProcess[str]:
        """A command as root in the container, to its end."""
        enter = ["nsenter", f"--target={self._leader}", "--mount", "--uts", "--ipc", "--net", "--pid"]
        environment = ["/usr/bin/env", "-i", f"PATH={PATH}", "LC_ALL=C.UTF-8", "DEBIAN_FRONTEND=noninteractive"]
        return subprocess.run(
            [*enter, *environment, *command],
            capture_output=True,
            text=True,
            input=stdin,
            timeout=COMMAND_WITHIN_S,
            check=False,
        )

    def must(self, *command: str) -> str:
        """The output of a command that succeeds. Raises BootError."""
        done = self.run(*command)
        if done.returncode != 0:
            raise BootError(f"{' '.join(command)}: exit code {done.returncode}: {(done.stderr or done.stdout).strip()}")
        return done.stdout

    def stop(self) -> None:
        """Shut the container down; it is killed if it does not end."""
        if self._process is None or self._process.poll() is not None:
            return
        self._process.send_signal(signal.SIGTERM)  # systemd-nspawn asks for an orderly end
        try:
            self._process.wait(STOP_WITHIN_S)
        except subprocess.TimeoutExpired:
            os.kill(self._leader, signal.SIGKILL)
            self._process.wait(STOP_WITHIN_S)

    def __enter__(self) -> Machine:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()


def until(condition: Callable[[], object], within_s: float, period_s: float = 0.05) -> None:
    """Wait for a condition. Raises BootError."""
    end_s = time.monotonic() + within_s
    while not condition():
        if time.monotonic() > end_s:
            raise BootError(f"not within {within_s:g} s")
        time.sleep(period_s)
