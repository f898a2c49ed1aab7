"""What commands print (findings in columns, JSON), and files that are complete or absent."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TextIO

import msgspec

WIDEST_FOUND = 44  # characters; a longer value shifts only its own line
FoundRow = tuple[str, str, str, str]  # verdict, subject, what was found, what follows


def json_text(value: Any) -> str:
    """The value as JSON on several lines."""
    return msgspec.json.format(msgspec.json.encode(value), indent=2).decode()


def found_lines(rows: Sequence[FoundRow], verdict_width: int) -> Iterator[str]:
    """One line per row, in columns."""
    subject_width = max((len(subject) for _, subject, _, _ in rows), default=0)
    found_width = min(WIDEST_FOUND, max((len(found) for _, _, found, _ in rows), default=0))
    for verdict, subject, found, more in rows:
        yield f"{verdict:<{verdict_width}} {subject:<{subject_width}}  {found:<{found_width}}  {more}".rstrip()


def line_printer(as_json: bool) -> Callable[[Iterable[str]], None]:
    """Prints lines, or none where the output is one JSON object."""

    def show(lines: Iterable[str]) -> None:
        for line in lines:
            if not as_json:
                print(line)

    return show


@contextmanager
def complete_or_absent(path: Path) -> Iterator[TextIO]:
    """A file that ends in .part until it is complete, and then replaces an older one; after an exception it is removed.

    Raises OSError.
    """
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("w", newline="", encoding="utf-8") as file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
