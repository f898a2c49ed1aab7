"""`companion export`: decisions and statuses of recordings as CSV files, on one time."""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TextIO

from companion.recording.alignment import Clock, align
from companion.recording.reader import Recording, RecordingError, recordings
from companion.recording.records import DECISION, STATUS, DecisionRecord
from companion.tools.columns import AXES, Table
from companion.types.printable import printable
from companion.types.status import NO_STATE_AGE_S
from companion.wire.ground import StatusReport

DECISIONS, STATUSES = Table(DecisionRecord), Table(StatusReport)
TIME_COLUMNS = ("time_s", "unix_s")
DIGITS = 6
STATE_COLUMNS = frozenset(
    {
        "status_state_age_s",
        *(f"status_position_{axis}_m" for axis in AXES),
        *(f"status_velocity_{axis}_m_s" for axis in AXES),
    }
)


class ExportError(Exception):
    """Nothing can be exported, or a file cannot be written. str() is one line."""


@dataclass(frozen=True, slots=True)
class Written:
    """One CSV file."""

    path: Path
    rows: int


@dataclass(frozen=True, slots=True)
class CsvKind:
    """The records that become one file: its name ends in `name`. `cells` makes the row of a record."""

    name: str
    topic: str
    columns: tuple[str, ...]
    cells: Callable[[Any], list[Any]]


def _status_cells(report: StatusReport) -> list[Any]:
    """Position, velocity and their age are empty before the first position."""
    cells = STATUSES.cells(report)
    if report.status.state_age_s < NO_STATE_AGE_S:
        return cells
    return ["" if name in STATE_COLUMNS else cell for name, cell in zip(STATUSES.names, cells, strict=True)]


KINDS = (
    CsvKind("decision", DECISION, DECISIONS.names, DECISIONS.cells),
    CsvKind("status", STATUS, STATUSES.names, _status_cells),
)


def export(folder: Path, out: Path) -> Iterator[Written]:
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
        for name, one, clock in zip(_names(found), found, clocks, strict=True):
            for kind in KINDS:
                yield _written(out / f"{name}_{kind.name}.csv", one, clock, begin_s, kind)
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


def _written(path: Path, recording: Recording, clock: Clock, begin_s: float, kind: CsvKind) -> Written:
    """Raises OSError."""
    rows = 0
    with _complete_or_absent(path) as file:
        writer = csv.writer(file)
        writer.writerow((*TIME_COLUMNS, *kind.columns))
        for message in recording.read([kind.topic], _warn):
            common_s = clock.common_s(message.now_s)
            writer.writerow((round(common_s - begin_s, DIGITS), round(common_s, DIGITS), *kind.cells(message.value)))
            rows += 1
    return Written(path, rows)


@contextmanager
def _complete_or_absent(path: Path) -> Iterator[TextIO]:
    """A file that ends in .part until it is complete, and then replaces an older one; after an exception it is removed."""
    part = path.with_name(f"{path.name}.part")
    try:
        with part.open("w", newline="", encoding="utf-8") as file:
            yield file
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)


def _warn(line: str) -> None:
    print(line, file=sys.stderr)
