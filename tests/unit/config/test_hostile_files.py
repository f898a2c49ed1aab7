"""Files that would hang or fill the memory, and names that would control the terminal: one line, after bounded work."""

from __future__ import annotations

import logging
import os
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from common import count_calls
from companion.config.file import MAX_BYTES, MAX_VALUES, ConfigError, read_yaml
from companion.link.log import PrintableFormatter
from companion.types.values import printable

MOST_CALLS = 2_000_000  # of functions; the largest file that is accepted needs 1.7 million


def bomb(merge: str = "") -> str:
    """Ten levels of ten aliases each."""
    lines = ["a0: &a0 {k: 1}" if merge else "a0: &a0 [1, 1]"]
    for n in range(1, 10):
        aliases = ", ".join([f"*a{n - 1}"] * 10)
        lines.append(f"a{n}: &a{n} {{<<: [{aliases}], k{n}: 1}}" if merge else f"a{n}: &a{n} [{aliases}]")
    return "\n".join(lines)


def fifo(path: Path) -> None:
    os.mkfifo(path)


def text(content: str) -> Callable[[Path], None]:
    return lambda path: path.write_text(content, encoding="utf-8") and None


HOSTILE: dict[str, Callable[[Path], object]] = {
    "aliases": text(bomb()),
    "merged aliases": text(bomb("<<")),
    "named pipe": fifo,
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "terminal device": lambda path: path.symlink_to("/dev/null"),
    "10 MB": lambda path: path.write_bytes(b"- [1, 2, 3]\n" * 900_000),
    "10 MB in one line": lambda path: path.write_bytes(b"a" * 10_000_000),
    "largest file": lambda path: path.write_bytes(b"[" * MAX_BYTES),
    "many values": lambda path: path.write_bytes(b"- [1, 2, 3]\n" * (MAX_BYTES // 12)),
    "folder": lambda path: path.mkdir(),
    "zero bytes": lambda path: path.write_bytes(b"\0" * 1000),
    "no text": lambda path: path.write_bytes(bytes(range(256))),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_file_is_refused_in_one_line_after_bounded_work(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "fleet.yaml"
    HOSTILE[kind](path)
    with pytest.raises(ConfigError) as caught, count_calls() as work:
        read_yaml(path)
    assert work.calls < MOST_CALLS
    assert len(str(caught.value).splitlines()) == 1
    assert str(path) in str(caught.value)


def test_a_missing_file_with_a_zero_byte_in_its_name_is_refused() -> None:
    with pytest.raises(ConfigError):
        read_yaml(Path("fleet\0.yaml"))


def test_a_file_may_use_aliases(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text("a: &a [1, 2]\nb: [*a, *a]\n", encoding="utf-8")
    assert read_yaml(path) == {"a": [1, 2], "b": [[1, 2], [1, 2]]}
    path.write_text("[" + "1, " * (MAX_VALUES + 1) + "]", encoding="utf-8")
    with pytest.raises(ConfigError):
        read_yaml(path)


@pytest.mark.parametrize("character", ["\0", "\x1b", "\x9b", "\x7f", "\u202e", "\u2066", "\u200b", "\ud800", "\r"])
def test_no_character_of_a_foreign_text_controls_the_terminal(character: str) -> None:
    assert printable(f"a{character}b") == "a?b"
    error = ConfigError(f"fleet{character}.yaml", f"field{character}", f"value{character}")
    assert str(error) == "fleet?.yaml: field?: value?"
    record = logging.LogRecord("x", logging.INFO, "x", 1, "from %s", (f"a{character}b",), None)
    assert PrintableFormatter().format(record) == "from a?b"


def test_an_error_comes_out_of_another_process() -> None:
    error = ConfigError.of([ConfigError("a.yaml", "x", "first"), ConfigError("b.yaml", "", "second")])
    assert pickle.loads(pickle.dumps(error)).lines == error.lines == ("a.yaml: x: first", "b.yaml: second")
