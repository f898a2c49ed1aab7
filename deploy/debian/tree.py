"""The files of the Debian package, as a tree: what goes where, with which mode."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Sequence
from pathlib import Path

DEPLOY = Path(__file__).resolve().parents[1]
ROOT = DEPLOY.parent
UNITS = ("companion@.service", "companion-monitor.service", "companion-router.service")
SCRIPTS = ("preinst", "postinst", "prerm", "postrm")
EXAMPLES = ("companion.nft", "prometheus/alerts.yaml")  # for the operator to copy and change
JOURNALS = ("journald.conf.d", "journald@companion-monitor.conf.d")  # of the board, and of the monitor


def stage(tree: Path, wheels: Path, version: str, architecture: str, pythons: Sequence[str]) -> None:
    """Everything that dpkg-deb packs. /etc/companion is only a folder: what is in it belongs to the operator."""
    for folder in ("opt/companion", "etc/companion"):
        (tree / folder).mkdir(parents=True)
    _link(tree / "usr/bin/companion", "/opt/companion/bin/companion")
    carried = tree / "usr/lib/companion"
    for wheel in sorted(wheels.iterdir()):
        _copy(wheel, carried / "wheels" / wheel.name)
    _write(carried / "build", digest_of(wheels) + "\n")
    _write(carried / "pythons", "".join(f"{python}\n" for python in pythons))
    for unit in UNITS:
        _copy(DEPLOY / unit, tree / "usr/lib/systemd/system" / unit)
    for folder in JOURNALS:
        _copy(DEPLOY / "journald.conf", tree / "usr/lib/systemd" / folder / "50-companion.conf")
    _copy(DEPLOY / "70-companion.rules", tree / "usr/lib/udev/rules.d/70-companion.rules")
    documents = tree / "usr/share/doc/companion"
    _copy(ROOT / "LICENSE", documents / "copyright")
    _copy(ROOT / "docs" / "installation.md", documents / "installation.md")
    for example in EXAMPLES:
        _copy(DEPLOY / example, documents / "examples" / Path(example).name)
    _metadata(tree, version, architecture)


def digest_of(wheels: Path) -> str:
    """Twelve hexadecimal digits that name the content of these wheels, and so the environment made of them."""
    total = hashlib.sha256()
    for wheel in sorted(wheels.iterdir()):
        total.update(wheel.name.encode() + hashlib.sha256(wheel.read_bytes()).digest())
    return total.hexdigest()[:12]


def _metadata(tree: Path, version: str, architecture: str) -> None:
    files = [path for path in sorted(tree.rglob("*")) if path.is_file() and not path.is_symlink()]
    kilobytes = sum(path.stat().st_size for path in files) // 1024
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(tree)}\n" for path in files]
    control = (DEPLOY / "debian" / "control").read_text(encoding="utf-8")
    _write(tree / "DEBIAN/control", control.format(version=version, architecture=architecture, kilobytes=kilobytes))
    _write(tree / "DEBIAN/md5sums", "".join(sums))
    for script in SCRIPTS:
        _copy(DEPLOY / "debian" / script, tree / "DEBIAN" / script, mode=0o755)
    for folder in [tree, *(path for path in tree.rglob("*") if path.is_dir())]:
        folder.chmod(0o755)


def _copy(source: Path, target: Path, mode: int = 0o644) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(source, target)
    target.chmod(mode)


def _write(target: Path, text: str) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(text, encoding="utf-8")
    target.chmod(0o644)


def _link(link: Path, target: str) -> None:
    link.parent.mkdir(parents=True, exist_ok=True)
    link.symlink_to(target)
