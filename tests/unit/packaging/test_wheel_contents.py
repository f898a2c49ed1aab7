"""What the wheel holds: the two programs, marked as typed, and nothing that measures, soaks or attacks them."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

from setuptools import find_packages

from common import ROOT

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
LABORATORY = re.compile(r"benchmark|soak|hostile|fuzz|monitor_load|large_fleet|^sitl/(bench|transports)/")


def modules() -> list[str]:
    packages = find_packages(str(ROOT), include=SETTINGS["tool"]["setuptools"]["packages"]["find"]["include"])
    folders = [ROOT / package.replace(".", "/") for package in packages]
    return [str(path.relative_to(ROOT)) for folder in folders for path in folder.glob("*.py")]


def test_the_wheel_holds_no_part_of_the_laboratory() -> None:
    assert {Path(module).parts[0] for module in modules()} == {"companion", "sitl"}
    assert [module for module in modules() if LABORATORY.search(module)] == []


def test_files_that_are_no_modules_are_in_the_wheel() -> None:
    data = SETTINGS["tool"]["setuptools"]["package-data"]
    patterns = [
        (ROOT / package.replace(".", "/"), pattern) for package, patterns in data.items() for pattern in patterns
    ]
    packed = {path for folder, pattern in patterns for path in folder.glob(pattern)}
    files = {path for program in ("companion", "sitl") for path in (ROOT / program).rglob("*") if path.is_file()}
    assert {path for path in files if path.suffix not in (".py", ".pyc")} <= packed


def test_both_programs_are_marked_as_typed() -> None:
    data = SETTINGS["tool"]["setuptools"]["package-data"]
    for program in ("companion", "sitl"):
        assert "py.typed" in data[program]
        assert (ROOT / program / "py.typed").is_file()
