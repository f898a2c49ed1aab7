"""Text for terminals: wrapped lines, counts and ids of vehicles."""

from __future__ import annotations

import shutil
import textwrap
from collections.abc import Collection

from companion.types.values import printable

WIDEST, NARROWEST = 100, 60  # columns of an answer


def wrapped(head: str, text: str) -> list[str]:
    """`head` and the text in lines of at most WIDEST columns, fewer on a narrow terminal; the text is indented below itself."""
    columns = shutil.get_terminal_size((WIDEST, 24)).columns
    width = min(WIDEST, max(NARROWEST, columns))
    return textwrap.wrap(
        printable(text),
        width,
        initial_indent=head,
        subsequent_indent=" " * min(len(head), width // 2),
        break_on_hyphens=False,
    ) or [head.rstrip()]


def count(vehicles: int) -> str:
    return f"{vehicles} vehicle{'' if vehicles == 1 else 's'}"


def id_list(vehicle_ids: Collection[int]) -> str:
    """ "vehicle 3" or "vehicles 1, 2"."""
    plural = "" if len(vehicle_ids) == 1 else "s"
    return f"vehicle{plural} {', '.join(map(str, sorted(vehicle_ids)))}"
