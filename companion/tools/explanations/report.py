"""Explanations for a terminal."""

from __future__ import annotations

import textwrap

from companion.tools.explanations.table import EXPLANATIONS, SECTIONS

COLUMNS = 100
CODE_COLUMNS = 33


def report(code: str) -> str:
    """The entry of a code, wrapped to COLUMNS. Raises KeyError."""
    entry = EXPLANATIONS[code]
    lines = [code]
    for name, text in (("symptom", entry.symptom), ("cause", entry.cause), ("remedy", entry.remedy)):
        lines += textwrap.wrap(text, COLUMNS, initial_indent=f"  {name:<9}", subsequent_indent=" " * 11)
    return "\n".join(lines)


def listing() -> str:
    """All codes by subject, each with its symptom in one line of at most COLUMNS."""
    lines = []
    for title, entries in SECTIONS.items():
        lines.append(f"{title}:")
        for code, entry in entries.items():
            symptom = textwrap.shorten(entry.symptom, COLUMNS - 2 - CODE_COLUMNS, placeholder=" ...")
            lines.append(f"  {code:<{CODE_COLUMNS}}{symptom}")
    return "\n".join(lines)
