"""Python files that a configuration names: what is run, from where, and what is refused with one line."""

import hashlib
import os
import pickle
import sys
from pathlib import Path

import pytest

from companion.config.code_file import CodeFile, load_code
from companion.config.file import ConfigError

ANOTHER_USER = 12345


@pytest.fixture
def beside(tmp_path: Path) -> Path:
    """A configuration file in a folder that only its owner can write."""
    folder = tmp_path / "vehicle"
    folder.mkdir(mode=0o755)
    file = folder / "vehicle.yaml"
    file.write_text("id: 1\n", encoding="utf-8")
    return file


def written(beside: Path, text: str, name: str = "code.py", mode: int = 0o644) -> Path:
    path = beside.parent / name
    path.write_text(text, encoding="utf-8")
    path.chmod(mode)
    return path


def refusal(path: Path, beside: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        load_code(path, beside)
    (line,) = caught.value.lines
    return line


def loaded(beside: Path, text: str) -> CodeFile:
    written(beside, text)
    return load_code(Path("code.py"), beside)


def test_it_runs_once_and_is_known_by_its_content(beside: Path) -> None:
    text = "from math import tau\nruns = 1\n"
    code = loaded(beside, text)
    assert (code.namespace["runs"], code.namespace["tau"]) == (1, pytest.approx(6.2832, abs=1e-4))
    assert code.sha256 == hashlib.sha256(text.encode()).hexdigest()
    assert load_code(beside.parent / "code.py", beside).sha256 == code.sha256  # a whole path to the same folder
    assert sorted(path.name for path in beside.parent.iterdir()) == ["code.py", "vehicle.yaml"]  # no compiled file


def test_its_classes_are_like_those_of_a_module(beside: Path) -> None:
    text = (
        "from __future__ import annotations\nfrom dataclasses import dataclass\n"
        "@dataclass\nclass Point:\n    x: float\nplace = Point(2.0)\n"
    )
    place = loaded(beside, text).namespace["place"]
    assert pickle.loads(pickle.dumps(place)).x == 2.0


@pytest.mark.parametrize("name", ["../code.py", "other/code.py", "/tmp/code.py"])
def test_only_the_folder_of_the_configuration_counts(beside: Path, name: str) -> None:
    (beside.parent / "other").mkdir()
    for folder in (beside.parent.parent, beside.parent / "other"):
        (folder / "code.py").write_text("raise AssertionError\n", encoding="utf-8")
    assert "expected a file in its own folder" in refusal(Path(name), beside)


def test_a_link_is_not_followed(beside: Path) -> None:
    outside = beside.parent.parent / "outside.py"
    outside.write_text("x = 1\n", encoding="utf-8")
    (beside.parent / "code.py").symlink_to(outside)
    assert "not a symbolic link" in refusal(Path("code.py"), beside)


@pytest.mark.parametrize("mode", [0o664, 0o646, 0o666])
def test_a_file_that_others_may_write_is_refused(beside: Path, mode: int) -> None:
    path = written(beside, "x = 1\n", mode=mode)
    assert refusal(path, beside) == (
        f"{path}: others may write it (mode {mode:o}) and its code is run; chmod go-w {path}"
    )


@pytest.mark.parametrize("mode", [0o775, 0o757])
def test_a_folder_that_others_may_write_is_refused(beside: Path, mode: int) -> None:
    path = written(beside, "x = 1\n")
    beside.parent.chmod(mode)
    assert refusal(path, beside).startswith(f"{beside.parent}: others may write it (mode {mode:o})")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a file to another user")
@pytest.mark.parametrize("foreign", ["file", "folder"])
def test_what_belongs_to_another_user_is_refused(beside: Path, foreign: str) -> None:
    path = written(beside, "x = 1\n")
    changed = path if foreign == "file" else beside.parent
    os.chown(changed, ANOTHER_USER, -1)
    assert refusal(path, beside).startswith(f"{changed}: belongs to user {ANOTHER_USER}; expected")


def test_what_belongs_to_root_may_be_run_by_all(beside: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    written(beside, "x = 1\n")
    owner = beside.stat().st_uid
    monkeypatch.setattr(os, "geteuid", lambda: ANOTHER_USER)
    if owner == 0:
        assert load_code(Path("code.py"), beside).namespace["x"] == 1
    else:
        assert f"belongs to user {owner}" in refusal(Path("code.py"), beside)


def test_what_is_no_file_is_refused(beside: Path) -> None:
    os.mkfifo(beside.parent / "pipe.py")
    (beside.parent / "folder.py").mkdir()
    written(beside, "#" * 200_000, "large.py")
    for name, words in {
        "missing.py": "No such file",
        "pipe.py": "not a regular file",
        "folder.py": "Is a directory",
        "large.py": "larger than 128 kB",
        "\0.py": "zero byte",
    }.items():
        assert words in refusal(Path(name), beside), name


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = 1\ny = (\n", "line 2: SyntaxError"),
        ("x = 1\n\nraise KeyError('no')\n", "line 3: KeyError: 'no'"),
        ("def f():\n    1 / 0\nf()\n", "line 2: ZeroDivisionError: division by zero"),
        ("raise SystemExit\n", "line 1: SystemExit"),
        ("import a_module_beside\n", "line 1: ModuleNotFoundError"),
        ("x = 1\0\n", "source code string cannot contain null bytes"),
    ],
)
def test_code_that_does_not_run_is_named_with_its_line(beside: Path, text: str, words: str) -> None:
    written(beside, "", "a_module_beside.py")
    path, before = written(beside, text), set(sys.modules)
    line = refusal(path, beside)
    assert line.startswith(f"{path}: ") and words in line
    assert not {name for name in set(sys.modules) - before if name.startswith("companion_code_")}


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("import socket", "line 1: imports socket"),
        ("import math\nfrom os import path", "line 2: imports os"),
        ("import urllib.request", "line 1: imports urllib.request"),
        ("from numpy import random", "line 1: imports numpy.random"),
        ("from companion.link import tick", "line 1: imports companion.link"),
        ("def f():\n    print('x')", "line 2: uses print"),
        ("x = 1\ndef f():\n    global x\n    x = 2", "line 3: changes x outside its function"),
    ],
)
def test_code_that_does_more_than_compute_is_refused_before_it_runs(beside: Path, text: str, found: str) -> None:
    written(beside, f"{text}\nraise SystemError\n")
    line = refusal(Path("code.py"), beside)
    assert f"code.py: {found}; expected code that computes from its arguments alone" in line


def test_code_that_computes_may_import_what_it_likes(beside: Path) -> None:
    loaded(beside, "import math, functools, numpy\nfrom companion.types.values import ZERO3\n")


def test_a_folder_for_everybody_is_not_to_be_changed(beside: Path) -> None:
    path = written(beside, "")
    beside.parent.chmod(0o1777)
    assert "everybody may write files there, and its code is run; use a folder of your own" in refusal(path, beside)
