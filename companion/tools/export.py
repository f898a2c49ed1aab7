"""`companion export`: decisions and statuses of recordings as CSV files, on one time."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec import Struct

from companion.recording.alignment import Clock, align
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import DECISION, STATUS, DecisionRecord
from companion.tools.columns import Table
from companion.types.printable import printable
from companion.wire.ground import StatusReport

TABLES: dict[str, tuple[str, type[Struct]]] = {DECISION: ("decision", DecisionRecord), STATUS: ("status", StatusReport)}
TIME_COLUMNS = ("time_s", "unix_s")
DIGITS = 6


class ExportError(Exception):
    """Nothing can be exported, or a file cannot be written. str() is one line."""


@dataclass(frozen=True, slots=True)
class Written:
    """One CSV file."""

    path: Path
    rows: int


def export(folder: Path, out: Path) -> list[Written]:
    """Writes the files, of each start of each vehicle one for decisions and one for statuses. Raises ExportError.

    `time_s` is since the first record of the flight, `unix_s` the same by the date of the first vehicle. Both are common to all
    vehicles, as far as their clocks can be compared.
    """
    try:
        found = [one for one in recordings(folder, _warn) if one.vehicle_id]
    except RecordingError as error:
        raise ExportError(str(error)) from error
    if not found:
        raise ExportError(f"{printable(str(folder))}: only the ground recorded here; there are no decisions to export")
    clocks = align(found, _warn)
    for one, clock in zip(found, clocks, strict=True):
        if len(found) > 1 and not clock.is_aligned:
            _warn(
                f"{one.name}: its clock cannot be compared with the others, by packets in both directions; its date is used"
            )
    begin_s = min(clock.common_s(one.header.monotonic_s) for one, clock in zip(found, clocks, strict=True))
    try:
        out.mkdir(parents=True, exist_ok=True)
        return [
            _written(out / f"{name}_{kind}.csv", one, clock, begin_s, topic)
            for name, one, clock in zip(_names(found), found, clocks, strict=True)
            for topic, (kind, _) in TABLES.items()
        ]
    except OSError as error:
        raise ExportError(f"{printable(str(error.filename or out))}: cannot be written: {error.strerror}") from error


def _names(found: Sequence[Recording]) -> list[str]:
    """vehicle-3, or vehicle-3_start-2 where an agent started several times."""
    starts = Counter(one.vehicle_id for one in found)
    seen: Counter[int] = Counter()
    names = []
    for one in found:
        seen[one.vehicle_id] += 1
        several = f"_start-{seen[one.vehicle_id]}" if starts[one.vehicle_id] > 1 else ""
        names.append(f"vehicle-{one.vehicle_id}{several}")
    return names


def _written(path: Path, recording: Recording, clock: Clock, begin_s: float, topic: str) -> Written:
    """Raises OSError. An older file is replaced."""
    table, rows = Table(TABLES[topic][1]), 0
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow((*TIME_COLUMNS, *table.names))
        for message in recording.read([topic], _warn):
            common_s = clock.common_s(message.now_s)
            writer.writerow((round(common_s - begin_s, DIGITS), round(common_s, DIGITS), *table.cells(message.value)))
            rows += 1
    return Written(path, rows)


def _warn(line: str) -> None:
    print(line, file=sys.stderr)
