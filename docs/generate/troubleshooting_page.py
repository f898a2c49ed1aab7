"""docs/troubleshooting.md, from the table of codes that `companion explain` prints."""

from __future__ import annotations

import textwrap

from companion.types.code_table import CodeEntry, code_table

HEAD = """\
# Troubleshooting by code

<!-- This page is generated from companion/types/codes.toml by `make docs`. Do not edit it. -->

Refusals, findings, events and health flags carry a code. A message reads `CODE: text`; JSON output
has the code in a field of its own. `companion explain CODE` prints an entry of this page in the
terminal, and `companion explain` lists all codes.
"""


def page() -> str:
    """One heading for each code, in the sections of the table."""
    parts = [HEAD]
    for title, entries in code_table().sections.items():
        parts.append(f"\n## {title}\n")
        parts += [_entry(code, entry) for code, entry in entries.items()]
    return "".join(parts)


def _entry(code: str, entry: CodeEntry) -> str:
    items = ("Symptom", entry.symptom), ("Cause", entry.cause), ("Remedy", entry.remedy)
    lines = [textwrap.fill(f"- **{name}**: {text}", 100, subsequent_indent="  ", **_WHOLE) for name, text in items]
    return f"\n### {code}\n\n" + "\n".join(lines) + "\n"


_WHOLE = {"break_long_words": False, "break_on_hyphens": False}
