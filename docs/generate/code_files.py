"""What is made of companion/types/codes.toml: docs/troubleshooting.md, and the enumerations that the agent reads."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable

from companion.types.code_table import CodeEntry, code_entries, code_table

PAGE_HEAD = """\
# Troubleshooting by code

<!-- This page is generated from companion/types/codes.toml by `make docs`. Do not edit it. -->

Refusals, findings, events and health flags carry a code. A message reads `CODE: text`; JSON output
has the code in a field of its own. `companion explain CODE` prints an entry of this page in the
terminal, and `companion explain` lists all codes.
"""


def troubleshooting() -> str:
    """One heading for each code, in the sections of the table."""
    parts = [PAGE_HEAD]
    for title, entries in code_table().sections.items():
        parts.append(f"\n## {title}\n")
        parts += [_entry(code, entry) for code, entry in entries.items()]
    return "".join(parts)


def _entry(code: str, entry: CodeEntry) -> str:
    items = ("Symptom", entry.symptom), ("Cause", entry.cause), ("Remedy", entry.remedy)
    lines = [textwrap.fill(f"- **{name}**: {text}", 100, subsequent_indent="  ", **_WHOLE) for name, text in items]
    return f"\n### {code}\n\n" + "\n".join(lines) + "\n"


_WHOLE = {"break_long_words": False, "break_on_hyphens": False}


MODULE_HEAD = '''\
"""Generated from companion/types/codes.toml by `make docs`. Do not edit it."""

from __future__ import annotations

from enum import StrEnum
'''
CODE = "The stable part of a notice. Tests, JSON output and the troubleshooting page go by it; texts may change."
HEALTH_FLAG = "Present faults, causes before what they cause. `core/safety/failsafe.py` has the actions."


def enumerations() -> str:
    """The text of the module: two enumerations and the texts of flags and rejected input."""
    texts = [f'    "{code}": "{entry.text}",' for code, entry in code_entries().items() if entry.text]
    parts = [
        MODULE_HEAD,
        _enumeration("Code", CODE, code_entries()),
        _enumeration("HealthFlag", HEALTH_FLAG, code_table().causes_first),
        "\n".join(["TEXTS: dict[str, str] = {", *texts, "}\n"]),
    ]
    return "\n\n".join(parts)


def _enumeration(name: str, docstring: str, members: Iterable[str]) -> str:
    lines = [f"class {name}(StrEnum):", f'    """{docstring}"""', ""]
    return "\n".join([*lines, *(f'    {member} = "{member}"' for member in members), ""])
