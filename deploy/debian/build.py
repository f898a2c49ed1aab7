"""Builds the Debian package: a wheel of the project, the wheels that it needs, units, rules and maintainer scripts.

The package carries wheels instead of a ready environment, because an environment belongs to one version of Python and to one
path. So one package serves several releases of Debian and Ubuntu, and an upgrade makes the new environment beside the one
that a running agent uses.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from deploy.debian.tree import stage

ROOT = Path(__file__).resolve().parents[2]
SOURCES = ("companion", "sitl", "pyproject.toml", "README.md", "LICENSE")
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
GLIBC_MINORS = range(17, 29)  # Debian 12 has 2.36, Ubuntu 22.04 has 2.35
PYTHONS = ("3.11", "3.12", "3.13")  # Debian 12, Ubuntu 24.04, Debian 13
TIME_OF_FILES_S = "1767225600"  # the same sources give the same wheel, so that its environment is made once


def main() -> int:
    """The exit code."""
    options = _options()
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        wheel = build_wheel(scratch, options.version)
        version = f"{wheel.name.split('-')[1]}-{options.revision}"
        for architecture in options.architectures:
            print(f"companion {version} for {architecture}, Python {', '.join(options.pythons)}", flush=True)
            wheels = scratch / f"wheels-{architecture}"
            for python in options.pythons:
                print(f"  collecting wheels for Python {python} ...", flush=True)
                collect_wheels(wheel, architecture, python, wheels)
            tree = scratch / f"tree-{architecture}"
            stage(tree, wheels, version, architecture, options.pythons)
            package = options.out / f"companion_{version}_{architecture}.deb"
            pack(tree, package)
            print(f"{package}: {package.stat().st_size / 1e6:.0f} MB")
    return 0


def build_wheel(scratch: Path, version: str | None) -> Path:
    """The wheel of the project, built from a copy: a build leaves folders behind, and old ones would change the result."""
    source = scratch / "source"
    source.mkdir()
    for name in SOURCES:
        path = ROOT / name
        if path.is_dir():
            shutil.copytree(path, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(path, source / name)
    if version is not None:
        module = source / "companion" / "__init__.py"
        text = re.sub(r'(?m)^__version__ = ".*"$', f'__version__ = "{version}"', module.read_text(encoding="utf-8"))
        module.write_text(text, encoding="utf-8")
    _pip("wheel", "--no-deps", "--wheel-dir", str(scratch / "wheel"), str(source))
    (wheel,) = (scratch / "wheel").glob("*.whl")
    return wheel


def collect_wheels(wheel: Path, architecture: str, python: str, folder: Path) -> None:
    """The wheel with all that its base install needs, for this machine and Python, without building anything."""
    machine = MACHINES[architecture]
    tags = [f"manylinux_2_{minor}_{machine}" for minor in GLIBC_MINORS] + [f"manylinux2014_{machine}"]
    platforms = [word for tag in tags for word in ("--platform", tag)]
    _pip(
        "download",
        "--only-binary=:all:",
        "--implementation=cp",
        f"--python-version={python}",
        *platforms,
        *("--dest", str(folder)),
        str(wheel),
    )


def pack(tree: Path, package: Path) -> None:
    """The .deb of a staged tree. Uncompressed, because wheels are compressed."""
    package.parent.mkdir(parents=True, exist_ok=True)
    subprocess.run(
        ["dpkg-deb", "--root-owner-group", "-Znone", "--build", str(tree), str(package)],
        check=True,
        stdout=subprocess.DEVNULL,
        env={**os.environ, "SOURCE_DATE_EPOCH": TIME_OF_FILES_S},
    )


def _pip(*arguments: str) -> None:
    environment = {**os.environ, "SOURCE_DATE_EPOCH": TIME_OF_FILES_S, "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    subprocess.run([sys.executable, "-m", "pip", arguments[0], "--quiet", *arguments[1:]], check=True, env=environment)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--architectures", nargs="+", choices=list(MACHINES), default=list(MACHINES))
    parser.add_argument(
        "--pythons", nargs="+", default=list(PYTHONS), metavar="X.Y", help="Python versions of the boards"
    )
    parser.add_argument("--version", help="instead of that of the source tree")
    parser.add_argument("--revision", default="1", help="of the package, counted up for each one of the same version")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "deb", metavar="DIR")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
