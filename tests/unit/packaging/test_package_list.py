"""The packages and data files that a build takes from the tree, without building and without a package index."""

import tomllib
from pathlib import Path

from setuptools import find_namespace_packages

from common import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
FOUND = PROJECT["tool"]["setuptools"]["packages"]["find"]
DATA = PROJECT["tool"]["setuptools"]["package-data"]
PROGRAMS = ("companion", "sitl")


def packaged() -> set[str]:
    return set(find_namespace_packages(where=str(ROOT), include=FOUND["include"]))


def folders_with(suffix: str) -> set[str]:
    """Folders of the two programs that hold files with this suffix, as dotted names."""
    files = [path for program in PROGRAMS for path in (ROOT / program).rglob(f"*{suffix}")]
    return {".".join(path.parent.relative_to(ROOT).parts) for path in files}


def test_every_folder_with_modules_is_packaged() -> None:
    assert folders_with(".py") <= packaged()


def test_every_folder_with_modules_has_an_init() -> None:
    assert [
        name for name in sorted(folders_with(".py")) if not (ROOT.joinpath(*name.split(".")) / "__init__.py").is_file()
    ] == []


def test_nothing_but_the_two_programs_is_packaged() -> None:
    assert {name.partition(".")[0] for name in packaged()} == set(PROGRAMS)


def test_every_data_file_is_packaged() -> None:
    named = (path for package, globs in DATA.items() for glob in globs for path in package_folder(package).glob(glob))
    taken = {path for path in named if path.is_file()}
    present = {
        path
        for program in PROGRAMS
        for path in [*(ROOT / program).rglob("*"), *(ROOT / "sitl" / "scenarios").glob("*")]
        if path.is_file() and path.suffix not in (".py", ".pyc")
    }
    assert present == taken
    assert {path.name for path in taken} >= {"platoon.yaml", "report.html.j2"}


def test_the_packaged_scenarios_are_those_of_config() -> None:
    packaged_names = {path.name for path in (ROOT / "sitl" / "scenarios").glob("*.yaml")}
    assert packaged_names == {path.name for path in (ROOT / "config" / "scenarios").glob("*.yaml")}


def package_folder(package: str) -> Path:
    return ROOT.joinpath(*package.split("."))
