"""The table of all codes, `codes.toml`: texts for people, severities, and what a report makes of an event.

Reading it takes 25 ms, so the agent does without: `generated/codes.py` has the enumerations and the short texts.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Literal, get_args

import msgspec
from msgspec import Struct

CODES_FILE = Path(__file__).with_name("codes.toml")
CodeSeverity = Literal["critical", "warning", "info"]
SEVERITIES: tuple[CodeSeverity, ...] = get_args(CodeSeverity)  # the worst first


class CodeEntry(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One code. `symptom`, `cause` and `remedy` are sentences; the head of the file explains the other fields."""

    symptom: str
    cause: str
    remedy: str
    text: str = ""
    severity: CodeSeverity = "critical"
    in_formation_only: bool = False
    in_every_phase: bool = False
    event: CodeSeverity | None = None
    topic: str = "failsafe"


class CodeTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The whole file. Both orders are of the health flags; `sections` has the entries by title and code."""

    causes_first: tuple[str, ...]
    worst_first: tuple[str, ...]
    sections: dict[str, dict[str, CodeEntry]]


@cache
def code_table() -> CodeTable:
    """The table. Raises msgspec.ValidationError for a file that is wrong."""
    return msgspec.toml.decode(CODES_FILE.read_bytes(), type=CodeTable)


@cache
def code_entries() -> dict[str, CodeEntry]:
    """The entries by code, in the order of the file."""
    return {code: entry for section in code_table().sections.values() for code, entry in section.items()}
