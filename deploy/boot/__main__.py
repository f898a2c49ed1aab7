"""Boots systemd on a bare Debian root with the Debian package, and checks the service as a board would run it.

It needs root, debootstrap and systemd-nspawn (apt install debootstrap systemd-container). The root is made once and kept in
build/boot; the container has no network. Times need a machine that does nothing else.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from pathlib import Path

from deploy.boot.flight import clean_stop, credentials, into_formation, journal, killed_and_hung, land, monitor, start
from deploy.boot.machine import SUITE, BootError, Machine, bare_root
from deploy.boot.packages import install, reinstall, remove_and_purge, upgrade_and_rollback
from deploy.boot.report import Results

ROOT = Path(__file__).resolve().parents[2]
BUILDER = ("-m", "deploy.debian.build")
NEEDED = {"debootstrap": "debootstrap", "systemd-nspawn": "systemd-container", "nsenter": "util-linux"}
PYTHON = "3.11"  # of the suite that is booted
NEXT_VERSION = "0.1.1.dev1"


def main() -> int:
    """0 where every check passed."""
    options = _options()
    missing = sorted({package for program, package in NEEDED.items() if not shutil.which(program)})
    if missing or os.geteuid() != 0:
        print(f"make boot needs root{''.join(f' and apt install {name}' for name in missing)}", file=sys.stderr)
        return 1
    options.folder.mkdir(parents=True, exist_ok=True)
    results = Results()
    try:
        _boot(options.folder, results)
    except BootError as error:
        results.check("not finished", False, str(error), "all steps")
    if options.out:
        options.out.write_text(results.page(f"{SUITE}"), encoding="utf-8")
    print(f"{len(results.all)} checks, {results.failed} failed")
    return 1 if results.failed else 0


def _boot(folder: Path, results: Results) -> None:
    _say("two versions of the package")
    old, new = _package(folder, None), _package(folder, NEXT_VERSION)
    _say("the bare root (some minutes the first time)")
    bare = bare_root(folder)
    with Machine(bare, folder) as machine:
        _say("systemd starts in the container")
        machine.boot()
        install(machine, old, results)
        _say("the agent beside a stand-in autopilot")
        service = start(machine, results)
        monitor(machine, results)
        killed_and_hung(service, results, "on the ground")
        credentials(machine, results)
        _say("formation flight of one vehicle")
        into_formation(machine, service)
        killed_and_hung(service, results, "in flight")
        land(machine, results)
        into_formation(machine, service)
        clean_stop(machine, service, results)
        _say("upgrade, rollback and removal, beginning in formation")
        into_formation(machine, service)
        upgrade_and_rollback(machine, service, old, new, results)
        reinstall(machine, old, results)
        journal(service, results)
        remove_and_purge(machine, service, results)


def _package(folder: Path, version: str | None) -> Path:
    """The package of the sources as they are, for this machine."""
    architecture = subprocess.run(["dpkg", "--print-architecture"], capture_output=True, text=True, check=True).stdout
    out = folder / "packages" / (version or "current")
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, *BUILDER, "--architectures", architecture.strip(), "--pythons", PYTHON]
    command += ["--out", str(out), *(("--version", version) if version else ())]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, cwd=ROOT)
    (package,) = out.glob("*.deb")
    return package


def _say(text: str) -> None:
    print(f"--    {text} ...", flush=True)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=ROOT / "build" / "boot", help="for the root and the packages")
    parser.add_argument("--out", type=Path, metavar="FILE", help="write the table as a page, docs/boot.md")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
