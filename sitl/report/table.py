"""Tables as text: a head of two lines, columns of a fixed width."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

Column = tuple[str, str, int]  # two lines of the head, and the width: negative for left alignment


def table_text(columns: Sequence[Column], rows: Iterable[Sequence[str]]) -> str:
    """The head and one line per row. A row has one cell per column."""
    above, below = [first for first, _, _ in columns], [second for _, second, _ in columns]
    return "\n".join(_line(columns, cells) for cells in (above, below, *rows))


def _line(columns: Sequence[Column], cells: Sequence[str]) -> str:
    return "".join(
        f"{cell:<{-width}}" if width < 0 else f"{cell:>{width}}"
        for cell, (_, _, width) in zip(cells, columns, strict=True)
    ).rstrip()
