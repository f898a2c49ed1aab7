"""A finding: something in a flight that deserves attention."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

from msgspec import Struct

from companion.tools.explanations.table import EXPLANATIONS
from companion.types.notices import Code

SAME_TIME_S = 0.5  # a command to all vehicles reaches them within this time
MOST_APART = 3  # rows of one code that stay apart; more become one row


class Severity(StrEnum):
    """In order. A critical finding must be understood before the next flight."""

    CRITICAL = "critical"
    WARNING = "warning"
    INFO = "info"


class FindingKind(StrEnum):
    """What a finding is about, in the order of the page."""

    CLOSE = "too close"
    FAILSAFE = "failsafe"
    LOST = "lost"
    LATE = "late"
    REFUSED = "refused"
    AUTOPILOT = "autopilot"
    RECORDING = "recording"


class Finding(Struct, frozen=True, kw_only=True):
    """`time_s` is since the first record. `vehicle_id` None: the whole fleet.

    `lasts_s` is how long it held, without pauses in between; None for a moment.
    `advice` is what to do, by `companion explain CODE`.
    """

    kind: FindingKind
    severity: Severity
    code: Code
    vehicle_id: int | None
    time_s: float
    lasts_s: float | None = None
    text: str
    advice: str


def finding(
    kind: FindingKind,
    severity: Severity,
    code: Code,
    vehicle_id: int | None,
    time_s: float,
    text: str,
    lasts_s: float | None = None,
) -> Finding:
    """A finding with the advice of its code."""
    return Finding(
        kind=kind,
        severity=severity,
        code=code,
        vehicle_id=vehicle_id,
        time_s=round(time_s, 3),
        lasts_s=None if lasts_s is None else round(lasts_s, 3),
        text=text,
        advice=EXPLANATIONS[code].remedy,
    )


class FindingRow(NamedTuple):
    """The same finding of several vehicles at one time, or often: one row of the page.

    `finding` is the first; of one that came often, the longest.
    """

    finding: Finding
    vehicle_ids: tuple[int, ...]  # empty: the whole fleet
    times: int = 1


def rows_of(findings: Sequence[Finding]) -> list[FindingRow]:
    """The rows of the page, in the order of their first findings. Critical ones are never put together by code."""
    rows = _by_time(findings)
    often = {
        key
        for key, count in Counter(_kind_of(row) for row in rows).items()
        if count > MOST_APART and key[0] is not Severity.CRITICAL
    }
    shown: dict[object, list[FindingRow]] = {}
    for n, row in enumerate(rows):
        key = _kind_of(row)
        shown.setdefault(key if key in often else n, []).append(row)
    return [_together(same) for same in shown.values()]


def _kind_of(row: FindingRow) -> tuple[Severity, FindingKind, Code]:
    return row.finding.severity, row.finding.kind, row.finding.code


def _together(same: Sequence[FindingRow]) -> FindingRow:
    """Rows of one code as one: the longest, with all vehicles."""
    longest = max(same, key=lambda row: row.finding.lasts_s or 0.0)
    return FindingRow(longest.finding, tuple(sorted({i for row in same for i in row.vehicle_ids})), len(same))


def _by_time(findings: Sequence[Finding]) -> list[FindingRow]:
    """One row for the same finding of several vehicles at one time."""
    rows: list[FindingRow] = []
    for one in findings:
        ids = () if one.vehicle_id is None else (one.vehicle_id,)
        same = next((n for n, row in enumerate(rows) if _is_same(row.finding, one)), None)
        if same is None or not ids:
            rows.append(FindingRow(one, ids))
        else:
            rows[same] = FindingRow(rows[same].finding, tuple(sorted({*rows[same].vehicle_ids, *ids})))
    return rows


def _is_same(a: Finding, b: Finding) -> bool:
    return (a.code, a.severity, a.text) == (b.code, b.severity, b.text) and abs(a.time_s - b.time_s) <= SAME_TIME_S


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, then by time."""
    ranks = list(Severity)
    return tuple(
        sorted(findings, key=lambda one: (ranks.index(one.severity), one.time_s, one.vehicle_id or 0, one.code))
    )
