"""`companion export`: decisions and statuses of recordings as CSV files, on one time.

A value of a Struct becomes cells: one column for each number, with its unit in its name.
"""

from __future__ import annotations

import csv
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any, get_args, get_origin

import msgspec
from msgspec import Struct
from msgspec.structs import fields

from companion.config.validation import alternatives
from companion.recording.alignment import RecordingClock, align
from companion.recording.mcap_file import Warn
from companion.recording.reader import Recording, recordings
from companion.recording.records import DECISION, STATUS, DecisionRecord
from companion.tools.output import complete_or_absent
from companion.types.errors import UnusableError
from companion.types.status import NO_STATE_AGE_S
from companion.types.values import printable
from companion.wire.messages import FlatReport, StatusReport, flat_report

Getter = Callable[[Any], Any]
AXES = ("east", "north", "up")


class Table:
    """The columns of a type. Nested values have the names of their fields in theirs; what is None leaves its cells empty."""

    def __init__(self, type_: type[Struct]) -> None:
        columns = list(_of_struct(type_, ""))
        self.names = tuple(name for name, _ in columns)
        self._getters = tuple(getter for _, getter in columns)

    def cells(self, value: Struct) -> list[Any]:
        return [getter(value) for getter in self._getters]


def _of_struct(type_: type[Struct], prefix: str) -> Iterator[tuple[str, Getter]]:
    for field in fields(type_):
        own = attrgetter(field.name)
        for name, getter in _columns(field.type, f"{prefix}{field.name}"):
            yield name, _chain(own, getter)


def _columns(type_: Any, name: str) -> Iterator[tuple[str, Getter]]:
    """Columns of a value with this name, each with what makes its cell of the value."""
    type_, *others = alternatives(type_)
    origin, parts = get_origin(type_), get_args(type_)
    if others:  # None
        yield from ((column, _unless_none(getter)) for column, getter in _columns(type_, name))
    elif isinstance(type_, type) and issubclass(type_, Struct):
        yield from _of_struct(type_, f"{name}_")
    elif origin is tuple and len(parts) == len(AXES) and "_enu_" in name:
        for index, axis in enumerate(AXES):
            yield name.replace("_enu_", f"_{axis}_"), itemgetter(index)
    else:
        yield name, _cell


def _chain(first: Getter, then: Getter) -> Getter:
    return lambda value: then(first(value))


def _unless_none(getter: Getter) -> Getter:
    return lambda value: "" if value is None else getter(value)


def _cell(value: Any) -> Any:
    """A list as its items with spaces between them, a count by key as its sum, a section as JSON, a yes or no as 1 or 0."""
    if isinstance(value, tuple | list):
        return " ".join(str(_cell(item)) for item in value)
    if isinstance(value, Mapping):
        counts = all(isinstance(item, int) for item in value.values())
        return sum(value.values()) if counts else msgspec.json.encode(value).decode()
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, bool):
        return int(value)
    return value


DECISIONS, STATUSES = Table(DecisionRecord), Table(FlatReport)
TIME_COLUMNS = ("time_s", "unix_s")
DIGITS = 6
STATE_COLUMNS = frozenset(
    {
        "status_state_age_s",
        *(f"status_position_{axis}_m" for axis in AXES),
        *(f"status_velocity_{axis}_m_s" for axis in AXES),
    }
)


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
    cells = STATUSES.cells(flat_report(report))
    if report.status.motion.state_age_s < NO_STATE_AGE_S:
        return cells
    return ["" if name in STATE_COLUMNS else cell for name, cell in zip(STATUSES.names, cells, strict=True)]


KINDS = (
    CsvKind("decision", DECISION, DECISIONS.names, DECISIONS.cells),
    CsvKind("status", STATUS, STATUSES.names, _status_cells),
)


def export(folder: Path, out: Path) -> Iterator[Written]:
    """Writes the files, of each start of each vehicle one for decisions and one for statuses. Raises UnusableError.

    `time_s` is since the first record of the flight, `unix_s` the same by the date of the first vehicle. Both are common to all
    vehicles, as far as their clocks can be compared.
    """
    warned = set[str]()  # a file is read once for each of its CSV files, and its damage reported once

    def warn(line: str) -> None:
        if line not in warned:
            warned.add(line)
            print(line, file=sys.stderr)

    found = [one for one in recordings(folder, warn) if one.vehicle_id]
    if not found:
        raise UnusableError(
            f"{printable(str(folder))}: only the ground recorded here; there are no decisions to export"
        )
    clocks = align(found, warn)
    for one, clock in zip(found, clocks, strict=True):
        if len(found) > 1 and not clock.is_aligned:
            warn(
                f"{one.name}: its clock cannot be compared with the others, by packets in both directions; its date is used"
            )
    begin_s = min(clock.common_s(one.header.monotonic_s) for one, clock in zip(found, clocks, strict=True))
    try:
        out.mkdir(parents=True, exist_ok=True)
        for name, one, clock in zip(_names(found), found, clocks, strict=True):
            for kind in KINDS:
                yield _write(out / f"{name}_{kind.name}.csv", one, clock, begin_s, kind, warn)
    except OSError as error:
        raise UnusableError(f"{printable(str(error.filename or out))}: cannot be written: {error.strerror}") from error


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


def _write(
    path: Path, recording: Recording, clock: RecordingClock, begin_s: float, kind: CsvKind, warn: Warn
) -> Written:
    """Raises OSError."""
    rows = 0
    with complete_or_absent(path) as file:
        writer = csv.writer(file)
        writer.writerow((*TIME_COLUMNS, *kind.columns))
        for message in recording.read([kind.topic], warn):
            common_s = clock.common_s(message.now_s)
            writer.writerow((round(common_s - begin_s, DIGITS), round(common_s, DIGITS), *kind.cells(message.value)))
            rows += 1
    return Written(path, rows)
