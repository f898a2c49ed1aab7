"""What deserves attention in a flight: findings and their rows on the page, and the times in which a condition held."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np
from msgspec import Struct

from companion.report.flight import Anything, Bools, Floats
from companion.types.code_table import code_entries
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
    code: Code,
    vehicle_id: int | None,
    time_s: float,
    text: str,
    *,
    lasts_s: float | None = None,
    kind: FindingKind | None = None,
    severity: Severity | None = None,
) -> Finding:
    """A finding with the advice of its code; kind and severity are those of the code where none are given."""
    entry = code_entries()[code]
    return Finding(
        kind=kind or FindingKind(entry.topic),
        severity=severity or Severity(entry.event or entry.severity),
        code=code,
        vehicle_id=vehicle_id,
        time_s=round(time_s, 3),
        lasts_s=None if lasts_s is None else round(lasts_s, 3),
        text=text,
        advice=entry.remedy,
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
    newest: dict[
        tuple[Code, Severity, str], int
    ] = {}  # row of the last finding that began one; they are in order of time
    for one in findings:
        ids = () if one.vehicle_id is None else (one.vehicle_id,)
        key = (one.code, one.severity, one.text)
        same = newest.get(key)
        if same is None or not ids or one.time_s - rows[same].finding.time_s > SAME_TIME_S:
            newest[key] = len(rows)
            rows.append(FindingRow(one, ids))
        else:
            rows[same] = FindingRow(rows[same].finding, tuple(sorted({*rows[same].vehicle_ids, *ids})))
    return rows


def in_order(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """The most severe first, then by time."""
    ranks = list(Severity)
    return tuple(
        sorted(findings, key=lambda one: (ranks.index(one.severity), one.time_s, one.vehicle_id or 0, one.code))
    )


HELD_S = 0.1  # a sample counts until the next one, at most for this time: gaps of a recording are no evidence
PAUSE_S = 1e-9  # less is rounding


class Interval(NamedTuple):
    begins_s: float
    ends_s: float

    @property
    def lasts_s(self) -> float:
        return self.ends_s - self.begins_s


class Episode(NamedTuple):
    """One or more stretches of time in which a condition held, from the first to the last, with the rows of its ends."""

    interval: Interval
    first: int
    last: int
    held_s: float  # without the pauses between the stretches
    longest_s: float  # duration of the longest stretch

    @property
    def duration_text(self) -> str:
        """How long it held; with pauses, also from when to when."""
        paused = self.interval.lasts_s - self.held_s > PAUSE_S
        return f"for {self.held_s:.2f} s" + (f" within {self.interval.lasts_s:.2f} s" if paused else "")


def runs(time_s: Floats, holds: Bools, apart_s: float = 0.0, held_s: float = HELD_S) -> list[Episode]:
    """The times in which a condition (n,) held; stretches with at most `apart_s` between them are one episode."""
    rows = np.flatnonzero(holds)
    if not rows.size:
        return []
    after = np.append(time_s[1:], np.inf)
    until_s = np.minimum(np.minimum(after, time_s + held_s), time_s[-1])
    pauses_s = time_s[rows[1:]] - until_s[rows[:-1]]
    return [
        _episode(time_s, until_s, part) for part in np.split(rows, np.flatnonzero(pauses_s > apart_s + PAUSE_S) + 1)
    ]


def _episode(time_s: Floats, until_s: Floats, rows: np.ndarray) -> Episode:
    """Of these rows, each of which holds until `until_s`."""
    begins = np.flatnonzero(np.append(np.inf, time_s[rows[1:]] - until_s[rows[:-1]]) > PAUSE_S)
    ends = np.append(begins[1:], rows.size) - 1
    lasts_s = until_s[rows[ends]] - time_s[rows[begins]]
    first, last = int(rows[0]), int(rows[-1])
    interval = Interval(float(time_s[first]), float(until_s[last]))
    return Episode(interval, first, last, float(lasts_s.sum()), float(lasts_s.max()))


def stretches(time_s: Floats, values: Anything) -> list[tuple[Interval, Any]]:
    """The intervals of equal values (n,), one after the other."""
    if not time_s.size:
        return []
    begins = np.concatenate(([0], np.flatnonzero(values[1:] != values[:-1]) + 1))
    ends = np.append(time_s[begins[1:]], time_s[-1])
    return [
        (Interval(float(time_s[row]), float(end_s)), values[row].item())
        for row, end_s in zip(begins, ends, strict=True)
    ]
