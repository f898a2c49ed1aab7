"""The files of the live page: complete, without the network, and fit for the server's Content-Security-Policy."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from common import ROOT

PAGE = ROOT / "companion" / "monitor" / "page"
VENDOR = PAGE / "vendor"
OF_TESTS = ROOT / "tests" / "page" / "vendor"
OWN = sorted(file for file in PAGE.rglob("*") if file.is_file() and VENDOR not in file.parents)
SCRIPTS = sorted(PAGE.rglob("*.js"))
STYLES = sorted(PAGE.rglob("*.css"))
IMPORT = re.compile(r"""(?:import|export)\b[^"';]*?from\s*["']([^"']+)["']|^import\s*["']([^"']+)["']""", re.MULTILINE)
LINK = re.compile(r'(?:href|src)="([^"#]+)"')
INLINE = re.compile(r"\son[a-z]+=|\sstyle=|<style|javascript:", re.IGNORECASE)
ELSEWHERE = re.compile(r"(?:https?:)?//[a-z0-9-]+\.[a-z]", re.IGNORECASE)


def names(files: list[Path]) -> list[str]:
    return [str(file.relative_to(PAGE)) for file in files]


@pytest.mark.parametrize("script", SCRIPTS, ids=names(SCRIPTS))
def test_every_import_is_a_file_of_the_page(script: Path) -> None:
    for match in IMPORT.finditer(script.read_text(encoding="utf-8")):
        target = match[1] or match[2]
        assert target.startswith("."), target
        assert (script.parent / target).is_file(), target


def test_every_link_is_a_file_of_the_page() -> None:
    links = LINK.findall((PAGE / "index.html").read_text(encoding="utf-8"))
    assert len(links) >= 5
    assert [link for link in links if not (PAGE / link).is_file()] == []


@pytest.mark.parametrize("file", OWN, ids=names(OWN))
def test_nothing_is_inline_and_nothing_from_elsewhere(file: Path) -> None:
    text = file.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
    assert INLINE.findall(text) == []
    assert ELSEWHERE.findall(text) == []


def test_every_part_of_the_page_is_used() -> None:
    """Each script but the first is imported, each style sheet linked."""
    imported = {
        (script.parent / (match[1] or match[2])).resolve()
        for script in SCRIPTS
        for match in IMPORT.finditer(script.read_text(encoding="utf-8"))
    }
    linked = {(PAGE / link).resolve() for link in LINK.findall((PAGE / "index.html").read_text(encoding="utf-8"))}
    assert {file.resolve() for file in (*SCRIPTS, *STYLES)} - imported - linked == set()


@pytest.mark.parametrize(("folder", "kind"), [(VENDOR, "dependencies"), (OF_TESTS, "devDependencies")])
def test_vendored_libraries_have_their_licences_and_versions(folder: Path, kind: str) -> None:
    """Those of the tests alone are not shipped."""
    wanted = json.loads((VENDOR / "package.json").read_text(encoding="utf-8"))[kind]
    locked = json.loads((VENDOR / "package-lock.json").read_text(encoding="utf-8"))["packages"]
    assert sorted(library.name for library in folder.iterdir() if library.is_dir()) == sorted(wanted)
    for name, version in wanted.items():
        assert (folder / name / "LICENSE").read_text(encoding="utf-8").strip()
        assert locked[f"node_modules/{name}"]["version"] == version
        assert locked[f"node_modules/{name}"]["integrity"].startswith("sha512-")
    assert not any("resolved" in package for package in locked.values())  # no download host


def test_texts_of_others_reach_the_page_through_lit_alone() -> None:
    """`unsafe` directives and innerHTML would run what a vehicle sends."""
    own = "".join(script.read_text(encoding="utf-8") for script in SCRIPTS if VENDOR not in script.parents)
    assert not re.search(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|unsafe|\beval\(|new Function", own)
