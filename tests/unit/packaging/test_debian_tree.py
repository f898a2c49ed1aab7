"""The staged tree of the Debian package: files, modes, metadata and maintainer scripts, without building wheels."""

from __future__ import annotations

import hashlib
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from common import ROOT
from deploy.debian.build import MACHINES, PYTHONS
from deploy.debian.tree import SCRIPTS, UNITS, digest_of, stage

DEBIAN = ROOT / "deploy" / "debian"
WHEELS = {"formation_companion-0.1.0-py3-none-any.whl": b"one", "numpy-2.4.6-cp311-cp311-linux_x86_64.whl": b"two"}


@pytest.fixture
def wheels(tmp_path: Path) -> Path:
    folder = tmp_path / "wheels"
    folder.mkdir()
    for name, content in WHEELS.items():
        (folder / name).write_bytes(content)
    return folder


@pytest.fixture
def tree(tmp_path: Path, wheels: Path) -> Path:
    stage(tmp_path / "tree", wheels, "0.1.0-1", "arm64", ("3.11", "3.13"))
    return tmp_path / "tree"


def test_every_file_has_its_place(tree: Path) -> None:
    files = {str(path.relative_to(tree)) for path in tree.rglob("*") if not path.is_dir()}
    systemd = "usr/lib/systemd"
    assert files == {
        *(f"DEBIAN/{name}" for name in ("control", "md5sums", *SCRIPTS)),
        *(f"usr/lib/companion/wheels/{name}" for name in WHEELS),
        *(f"{systemd}/system/{unit}" for unit in UNITS),
        *("usr/bin/companion", "usr/lib/companion/build", "usr/lib/companion/pythons"),
        f"{systemd}/journald.conf.d/50-companion.conf",
        f"{systemd}/journald@companion-monitor.conf.d/50-companion.conf",
        "usr/lib/udev/rules.d/70-companion.rules",
        *("usr/share/doc/companion/copyright", "usr/share/doc/companion/installation.md"),
        *(f"usr/share/doc/companion/examples/{name}" for name in ("companion.nft", "alerts.yaml")),
    }
    assert (tree / "usr/bin/companion").readlink() == Path("/opt/companion/bin/companion")


def test_the_configuration_is_a_folder_that_belongs_to_the_operator(tree: Path) -> None:
    assert list((tree / "etc/companion").iterdir()) == []
    assert not (tree / "DEBIAN/conffiles").exists()


def test_every_unit_of_deploy_is_packaged() -> None:
    assert {path.name for path in (ROOT / "deploy").glob("*.service")} == set(UNITS)


def test_modes_are_those_of_a_system(tree: Path) -> None:
    for path in tree.rglob("*"):
        if not path.is_symlink():
            script = path.parent.name == "DEBIAN" and path.name in SCRIPTS
            assert path.stat().st_mode & 0o777 == (0o755 if path.is_dir() or script else 0o644), path


def test_the_sums_are_those_of_the_files(tree: Path) -> None:
    lines = (tree / "DEBIAN/md5sums").read_text(encoding="ascii").splitlines()
    assert len(lines) == sum(path.is_file() and not path.is_symlink() for path in (tree / "usr").rglob("*"))
    for line in lines:
        total, _, path = line.partition("  ")
        assert hashlib.md5((tree / path).read_bytes()).hexdigest() == total


def test_the_build_is_named_after_the_wheels(tree: Path, wheels: Path) -> None:
    assert (tree / "usr/lib/companion/build").read_text(encoding="ascii").strip() == digest_of(wheels)
    before = digest_of(wheels)
    (wheels / "numpy-2.4.6-cp311-cp311-linux_x86_64.whl").write_bytes(b"three")
    assert digest_of(wheels) != before


@pytest.mark.skipif(not shutil.which("dpkg-deb"), reason="dpkg-deb is not installed")
def test_dpkg_packs_the_tree(tree: Path, tmp_path: Path) -> None:
    package = tmp_path / "companion.deb"
    subprocess.run(
        ["dpkg-deb", "--root-owner-group", "-Znone", "--build", tree, package], check=True, capture_output=True
    )
    fields = ["dpkg-deb", "--showformat=${Package} ${Version} ${Architecture}", "--show", str(package)]
    shown = subprocess.run(fields, check=True, capture_output=True, text=True).stdout
    assert shown == "companion 0.1.0-1 arm64"
    depends = subprocess.run(["dpkg-deb", "--field", package, "Depends"], check=True, capture_output=True, text=True)
    assert "python3 (>= 3.11)" in depends.stdout
    assert "python3-venv (>= 3.11)" in depends.stdout


@pytest.mark.parametrize("name", SCRIPTS)
def test_a_maintainer_script_is_strict_posix_shell(name: str) -> None:
    text = (DEBIAN / name).read_text(encoding="utf-8")
    assert text.startswith("#!/bin/sh\n")
    assert re.search(r"^set -e$", text, re.MULTILINE)
    assert len(text.splitlines()) < 80
    assert subprocess.run(["sh", "-n", DEBIAN / name], check=False).returncode == 0
    assert "[[" not in text


@pytest.mark.parametrize("name", ["preinst", "postinst", "postrm"])
def test_an_upgrade_stops_and_starts_no_agent(name: str) -> None:
    commands = [line for line in (DEBIAN / name).read_text(encoding="utf-8").splitlines() if "echo" not in line]
    assert not [line for line in commands if re.search(r"systemctl.*\b(re)?(start|stop)\b", line)]


def test_only_a_removal_stops_agents() -> None:
    text = (DEBIAN / "prerm").read_text(encoding="utf-8")
    assert '[ "$1" = remove ]' in text.partition("systemctl stop")[0]


def test_the_documents_name_what_the_package_supports() -> None:
    page = (ROOT / "docs" / "installation.md").read_text(encoding="utf-8")
    assert [name for name in (*MACHINES, *PYTHONS) if name not in page] == []


RULES = (ROOT / "deploy" / "70-companion.rules").read_text(encoding="utf-8")


def test_every_jump_of_the_udev_rules_has_its_label() -> None:
    lines = [line for line in RULES.splitlines() if not line.startswith("#")]
    goals = {goal for line in lines for goal in re.findall(r'GOTO="(\w+)"', line)}
    assert goals == set(re.findall(r'^LABEL="(\w+)"$', RULES, re.MULTILINE))


def test_the_autopilot_has_one_name() -> None:
    names = re.findall(r'SYMLINK\+="(\w+)"', RULES)
    assert set(names) == {"autopilot"}
    assert 'ATTRS{idVendor}=="26ac"' in RULES  # PX4
    assert 'ATTRS{idVendor}=="1209", ATTRS{idProduct}=="5741"' in RULES  # ArduPilot
