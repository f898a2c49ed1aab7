"""docs/troubleshooting.md, from the table of explanations that `companion explain` prints."""

from __future__ import annotations

import textwrap

from companion.tools.explanations.explanation import Explanation
from companion.tools.explanations.table import SECTIONS

HEAD = """\
# Troubleshooting by code

<!-- This page is generated from companion/tools/explanations by `make docs`. Do not edit it. -->

Refusals, findings, events and health flags carry a code. A message reads `CODE: text`; JSON output
has the code in a field of its own. `companion explain CODE` prints an entry of this page in the
terminal, and `companion explain` lists all codes.
"""


def page() -> str:
    """One heading for each code, in the sections of the table."""
    parts = [HEAD]
    for title, entries in SECTIONS.items():
        parts.append(f"\n## {title}\n")
        parts += [_entry(code, explanation) for code, explanation in entries.items()]
    return "".join(parts)


def _entry(code: str, explanation: Explanation) -> str:
    items = ("Symptom", explanation.symptom), ("Cause", explanation.cause), ("Remedy", explanation.remedy)
    lines = [textwrap.fill(f"- **{name}**: {text}", 100, subsequent_indent="  ", **_WHOLE) for name, text in items]
    return f"\n### {code}\n\n" + "\n".join(lines) + "\n"


_WHOLE = {"break_long_words": False, "break_on_hyphens": False}
