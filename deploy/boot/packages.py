"""The steps of the boot with the package: install, upgrade, rollback, removal, purge."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from deploy.boot.machine import Machine
from deploy.boot.report import Results
from deploy.boot.service import Service

CONFIGURATION = ("sh", "-c", "cd /etc/companion && find . -type f -exec sha256sum {} + | sort")
LEFT = (
    *("find", "/", "-xdev", "(", "-path", "/proc", "-o", "-path", "/sys", "-o", "-path", "/root", ")", "-prune", "-o"),
    *("-iname", "*companion*", "-print"),
)
UDEV = ("sh", "-c", "udevadm test /sys/class/tty/tty 2>&1")
RULES = "70-companion.rules"
RESTARTED = "running agents continue"


def put(machine: Machine, package: Path) -> str:
    """Copy a package into the container. Its path there."""
    shutil.copy(package, machine.root / "root" / package.name)
    return f"/root/{package.name}"


def install(machine: Machine, package: Path, results: Results) -> None:
    """Into the bare system, which has no network."""
    before_s = time.monotonic()
    machine.must("apt-get", "install", "--yes", put(machine, package))
    results.check("apt install without a network", True, f"{time.monotonic() - before_s:.1f} s", "no error")
    links = machine.must("sh", "-c", "ip -o link 2>/dev/null || ls /sys/class/net").split()
    results.check("the network of the container", links == ["lo"], " ".join(links), "lo only")
    read = [line for line in machine.run(*UDEV).stdout.splitlines() if RULES in line]
    accepted = len(read) == 1 and read[0].startswith("Reading rules file")
    results.check("udev accepts the rules", accepted, "no error" if accepted else " ".join(read), "no error")
    version = machine.must("companion", "--version").strip()
    results.check("companion on the PATH", version.startswith("companion "), version, "a version")


def upgrade_and_rollback(machine: Machine, service: Service, old: Path, new: Path, results: Results) -> None:
    """While the agent runs: it goes on with the version that it was started from, until it is restarted."""
    for name, package in (("upgrade", new), ("rollback", old)):
        kept, pid, phase = machine.must(*CONFIGURATION), service.pid, service.phase
        printed = machine.must("apt-get", "install", "--yes", "--allow-downgrades", put(machine, package))
        results.check(
            f"{name}: the running agent goes on", service.pid == pid, f"{service.phase}", f"{phase}, same process"
        )
        results.check(f"{name}: says so", RESTARTED in printed, _said(printed), "one line")
        results.check(f"{name}: configuration kept", machine.must(*CONFIGURATION) == kept, "same files", "same files")
        wanted = f"companion {package.name.split('_')[1].partition('-')[0]}"
        found = machine.must("companion", "--version").strip()
        results.check(f"{name}: version", found == wanted, found, wanted)
        before_s = time.monotonic()
        machine.must("systemctl", "restart", service.unit)
        service.back_after(before_s)
        program = machine.must("sh", "-c", f"tr '\\0' ' ' </proc/{service.pid}/cmdline").split()[0]
        environment = machine.must("readlink", "-f", "/opt/companion/bin").strip()
        results.check(
            f"{name}: restarted from it", program.startswith(environment), _short(program), _short(environment)
        )


def remove_and_purge(machine: Machine, service: Service, results: Results) -> None:
    """A removal stops the agent and keeps the configuration; a purge leaves nothing."""
    machine.must("systemctl", "stop", "autopilot")
    kept = machine.must(*CONFIGURATION)
    machine.must("apt-get", "remove", "--yes", "companion")
    results.check("removal stops the agent", service.pid == 0, service.value("ActiveState"), "no process")
    results.check("removal keeps the configuration", machine.must(*CONFIGURATION) == kept, "same files", "same files")
    machine.must("apt-get", "purge", "--yes", "companion")
    left = machine.must(*LEFT).split()
    results.check("purge leaves no file", not left, " ".join(left[:3]) or "none", "none")
    users = machine.run("sh", "-c", "getent passwd companion; getent group companion").stdout.strip()
    results.check("purge leaves no user", not users, users or "none", "none")


def reinstall(machine: Machine, package: Path, results: Results) -> None:
    """Environments that no agent uses are removed by the next installation."""
    environments = ("sh", "-c", "ls -d /opt/companion/env-*")
    before = len(machine.must(*environments).split())
    machine.must("apt-get", "install", "--yes", "--reinstall", put(machine, package))
    after = len(machine.must(*environments).split())
    results.check("unused environments are removed", after == 1, f"{before}, then {after}", "1")


def _short(path: str) -> str:
    return path.removeprefix("/opt/companion/")


def _said(printed: str) -> str:
    lines = [line for line in printed.splitlines() if RESTARTED in line]
    return f"{len(lines)} line" if lines else "nothing"
