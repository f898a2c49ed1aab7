"""Tests use public names: what a test must replace or read has one."""

from __future__ import annotations

import ast
from collections.abc import Iterator

import pytest

from common import ROOT

OF_OTHERS = {  # libraries have no public name for these
    "_exit": "os: the end of a forked process",
    "_actions": "argparse: the options of a parser",
    "_SubParsersAction": "argparse: its subcommands",
    "_tmp_path_factory": "pytest: where the tests of a session write",
    "_fixtureinfo": "pytest: the fixtures of a test",
    "_timestamp": "pymavlink: when a message of a log was received",
}
FOLDERS = sorted(path.name for path in (ROOT / "tests").iterdir() if any(path.rglob("*.py")))


def private_uses(source: str) -> Iterator[tuple[int, str]]:
    """(line, name) of each private name that code takes from another object or module, or replaces there by name."""
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        match node:
            case ast.Attribute(ast.Name("self" | "cls"), _):
                pass
            case ast.Attribute(_, name):
                names = [name]
            case ast.ImportFrom():
                names = [alias.name for alias in node.names]
            case ast.Call(ast.Name("getattr" | "setattr") | ast.Attribute(_, "setattr"), arguments):
                texts = [one.value for one in arguments if isinstance(one, ast.Constant) and isinstance(one.value, str)]
                names = [text.rpartition(".")[2] for text in texts[:1]]
            case _:
                pass
        for name in names:
            if name.startswith("_") and not name.startswith("__"):
                yield getattr(node, "lineno", 0), name


@pytest.mark.parametrize("folder", FOLDERS)
def test_tests_use_no_private_name(folder: str) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in sorted((ROOT / "tests" / folder).rglob("*.py"))
        for line, name in private_uses(path.read_text(encoding="utf-8"))
        if name not in OF_OTHERS
    ]
    assert found == []


def test_private_uses_are_found() -> None:
    source = (
        "from a import _b\nself._c = d._e.f\nx.setattr('g._h', 1)\nsetattr(i, '_j', getattr(k, 'l'))\nm.__class__\n"
    )
    assert sorted(private_uses(source)) == [(1, "_b"), (2, "_e"), (3, "_h"), (4, "_j")]
