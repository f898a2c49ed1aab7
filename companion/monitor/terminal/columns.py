"""The columns of the table: which of them a terminal shows, and their texts. Pure.

Designed for 80, 120 and 200 characters. A wider terminal shows more of them; the column `event` takes what is left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import isfinite

from companion.ground.fleet_status import SILENT_AFTER_S
from companion.monitor.terminal.fleet_rows import TableRow
from companion.types.values import printable

SEPARATOR = " "
NONE = "-"


@dataclass(frozen=True, slots=True)
class Column:
    """`width` in characters; shown on terminals of at least `from_columns` characters."""

    name: str
    width: int
    from_columns: int
    text: Callable[[TableRow], str]
    right: bool = False


def _phase(row: TableRow) -> str:
    return "SILENT" if row.vehicle.silent else row.vehicle.phase


def _flag(row: TableRow) -> str:
    """The worst one and how many others; of a silent vehicle what it was when it last reported."""
    if row.vehicle.silent:
        return f"was {row.vehicle.phase}{', armed' if row.vehicle.armed else ''}"
    if not row.problems:
        return NONE
    others = f" +{len(row.problems) - 1}" if len(row.problems) > 1 else ""
    worst = row.problems[0].code
    return worst + others if len(worst + others) <= FLAG_WIDTH else worst


def _nearest(row: TableRow) -> str:
    """Its name and distance; ! while the separation filter changes the command."""
    nearest = row.nearest
    if nearest is None:
        return NONE
    return f"{'!' if nearest.avoided else ''}{nearest.name}:{metres_text(nearest.distance_m)}"


def _live(text: Callable[[TableRow], str]) -> Callable[[TableRow], str]:
    """A silent vehicle has no value that holds now."""
    return lambda row: NONE if row.vehicle.silent else text(row)


def _of_fresh_position(text: Callable[[TableRow], str]) -> Callable[[TableRow], str]:
    """An old position has no value that holds now."""
    return lambda row: NONE if row.vehicle.data_age_s > SILENT_AFTER_S else text(row)


def _position(row: TableRow) -> str:
    return " ".join(f"{x:z.1f}" for x in row.vehicle.position_enu_m)


def _error(row: TableRow) -> str:
    error_m = row.vehicle.error_to_slot_m
    return NONE if error_m is None else metres_text(error_m)


def _battery(row: TableRow) -> str:
    percent = row.vehicle.battery_percent
    return NONE if percent is None else f"{percent:.0f}%"


def _estimator(row: TableRow) -> str:
    error = row.vehicle.position_error
    return NONE if error is None else metres_text(error.horizontal_m)


def _event(row: TableRow) -> str:
    return str(row.vehicle.last_event or NONE)


FLAG_WIDTH = 20
COLUMNS = (
    Column("id", 3, 0, lambda row: str(row.vehicle.vehicle_id), right=True),
    Column("phase", 9, 0, _phase),
    Column("mode", 12, 80, _live(lambda row: row.vehicle.mode_name)),
    Column("armed", 5, 42, _live(lambda row: "armed" if row.vehicle.armed else NONE)),
    Column("batt", 4, 47, _live(_battery), right=True),
    Column("error", 6, 60, _live(_error), right=True),
    Column(
        "age",
        5,
        53,
        lambda row: duration_text(row.vehicle.age_s if row.vehicle.silent else row.vehicle.data_age_s),
        right=True,
    ),
    Column("nearest", 8, 69, _nearest, right=True),
    Column("PrC", 3, 84, _live(lambda row: str(row.vehicle.prc)), right=True),
    Column("formation", 13, 98, _live(lambda row: row.vehicle.formation)),
    Column("Hz", 4, 103, _live(lambda row: f"{row.vehicle.timing.rate_hz:.1f}"), right=True),
    Column("late", 5, 109, _live(lambda row: duration_text(row.vehicle.timing.late_us.p99 / 1e6)), right=True),
    Column("peers", 5, 115, _live(lambda row: f"{len(row.vehicle.peers)}/{row.fleet_size - 1}"), right=True),
    Column("rej", 4, 120, _live(lambda row: count_text(row.vehicle.rejected)), right=True),
    Column("position", 21, 142, _live(_of_fresh_position(_position)), right=True),
    Column("sigma", 5, 148, _live(_of_fresh_position(_estimator)), right=True),
    Column("ref", 7, 156, _live(lambda row: row.vehicle.reference), right=True),
    Column("flag", FLAG_WIDTH, 0, _flag),
)
EVENT_FROM_COLUMNS = 185


def columns_for(width: int) -> list[Column]:
    """The columns for a terminal of this width; on a wide one the last event takes the rest of it."""
    shown = [column for column in COLUMNS if width >= column.from_columns]
    if width >= EVENT_FROM_COLUMNS:
        shown.append(Column("event", width - table_width(shown) - len(SEPARATOR), EVENT_FROM_COLUMNS, _event))
    return shown


def table_width(columns: Sequence[Column]) -> int:
    return sum(column.width + len(SEPARATOR) for column in columns) - len(SEPARATOR)


def cells(row: TableRow, columns: Sequence[Column]) -> list[str]:
    """One text for each column, none wider than its column."""
    return [_cut(printable(column.text(row)), column.width) for column in columns]


def line(texts: Sequence[str], columns: Sequence[Column]) -> str:
    """The texts as one line of the table."""
    padded = (
        text.rjust(column.width) if column.right else text.ljust(column.width)
        for text, column in zip(texts, columns, strict=True)
    )
    return SEPARATOR.join(padded).rstrip()


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def duration_text(age_s: float) -> str:
    """At most five characters, like 61ms, 4.2s, 75s, 12min or never."""
    if not isfinite(age_s) or age_s >= 1e5:
        return "never"
    if age_s < 0.9995:
        return f"{age_s * 1000:.0f}ms"
    if age_s < 600.0:
        return f"{age_s:.1f}s" if age_s < 99.95 else f"{age_s:.0f}s"
    return f"{age_s / 60.0:.0f}min" if age_s < 5970.0 else f"{age_s / 3600.0:.1f}h"


def metres_text(distance_m: float) -> str:
    """Centimetres below 10 m, then decimetres, from 100 m metres."""
    digits = 2 if distance_m < 9.995 else 1 if distance_m < 99.95 else 0
    return f"{distance_m:.{digits}f}m"


def count_text(number: int) -> str:
    """At most four characters, like 999, 12k or 3M."""
    for limit, unit, divisor in ((10_000, "", 1), (1_000_000, "k", 1_000), (1_000_000_000, "M", 1_000_000)):
        if number < limit:
            return f"{number // divisor}{unit}"
    return "many"
