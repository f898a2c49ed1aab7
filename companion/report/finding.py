"""A finding: something in a flight that deserves attention."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import NamedTuple

from msgspec import Struct

from companion.tools.explanations.table import EXPLANATIONS
from companion.types.notices import Code

SAME_TIME_S = 0.5  # a command to all vehicles reaches them within this time


class Severity(StrEnum):
    """In order. A critical finding must be understood before the next flight."""

    CRITICAL = "critical"
    WARNING = "warning"
    INFO = "info"


class Kind(StrEnum):
    """What a finding is about, in the order of the page."""

    CLOSE = "too close"
    FAILSAFE = "failsafe"
    LOST = "lost"
    LATE = "late"
    REFUSED = "refused"
    AUTOPILOT = "autopilot"
    RECORDING = "recording"


class Finding(Struct, frozen=True, kw_only=True):
    """`time_s` is since the first record, `lasts_s` None for a moment. `vehicle_id` None: the whole fleet.

    `advice` is what to do, by `companion explain CODE`.
    """

    kind: Kind
    severity: Severity
    code: Code
    vehicle_id: int | None
    time_s: float
    lasts_s: float | None = None
    text: str
    advice: str


def finding(
    kind: Kind,
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


class Row(NamedTuple):
    """The same finding of several vehicles at one time, as one row of the page."""

    finding: Finding
    vehicle_ids: tuple[int, ...]  # empty: the whole fleet


def rows_of(findings: Sequence[Finding]) -> list[Row]:
    """The rows of the page, in the order of their first findings."""
    rows: list[Row] = []
    for one in findings:
        ids = () if one.vehicle_id is None else (one.vehicle_id,)
        same = next((n for n, row in enumerate(rows) if _is_same(row.finding, one)), None)
        if same is None or not ids:
            rows.append(Row(one, ids))
        else:
            rows[same] = Row(rows[same].finding, tuple(sorted({*rows[same].vehicle_ids, *ids})))
    return rows


def _is_same(a: Finding, b: Finding) -> bool:
    return (a.code, a.severity, a.text) == (b.code, b.severity, b.text) and abs(a.time_s - b.time_s) <= SAME_TIME_S


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, then by time."""
    ranks = list(Severity)
    return tuple(
        sorted(findings, key=lambda one: (ranks.index(one.severity), one.time_s, one.vehicle_id or 0, one.code))
    )
