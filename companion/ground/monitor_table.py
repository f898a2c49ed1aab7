"""The table of `companion monitor`: its columns by the width of the terminal, and a note for each vehicle. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from math import hypot, isfinite

from companion.ground.fleet_status import VehicleRow
from companion.ground.text import count, id_list
from companion.types.flight import FLAG_TEXTS
from companion.types.printable import printable

SEPARATOR = " "


@dataclass(frozen=True, slots=True)
class Column:
    """`width` in characters; shown on terminals of at least `from_columns` columns."""

    name: str
    width: int
    from_columns: int
    text: Callable[[VehicleRow], str]
    right: bool = False


def _position(row: VehicleRow) -> str:
    return " ".join(f"{x:z.1f}" for x in row.position_enu_m)


def _error(row: VehicleRow) -> str:
    return "-" if row.error_to_slot_m is None else f"{row.error_to_slot_m:.2f} m"


def _battery(row: VehicleRow) -> str:
    return "-" if row.battery_percent is None else f"{row.battery_percent:.0f} %"


def _nearest(row: VehicleRow) -> str:
    """Distance of the nearest vehicle by the separation filter; ! while the filter changes the command."""
    nearest = row.separation.nearest
    if nearest is None:
        return "-"
    return f"{'!' if row.separation.changed_m_s2 > 0.0 else ''}{nearest.name} {nearest.distance_m:.1f} m"


COLUMNS = (
    Column("vehicle", 7, 0, lambda row: str(row.vehicle_id)),
    Column("phase", 9, 0, lambda row: row.phase),
    Column("mode", 12, 0, lambda row: row.mode_name),
    Column("armed", 5, 0, lambda row: "armed" if row.armed else "-"),
    Column("battery", 7, 0, _battery, right=True),
    Column("position", 18, 0, _position, right=True),
    Column("error", 7, 0, _error, right=True),
    Column("data", 6, 0, lambda row: duration_text(row.data_age_s), right=True),
    Column("PrC", 3, 100, lambda row: str(row.prc), right=True),
    Column("formation", 15, 100, lambda row: row.formation),
    Column("reference", 12, 120, lambda row: row.reference),
    Column("rej", 5, 120, lambda row: str(row.rejected), right=True),
    Column("operator", 16, 150, lambda row: row.holder or "-"),
    Column("hover", 5, 150, lambda row: f"{row.hover_thrust_norm:.2f}", right=True),
    Column("push", 8, 150, lambda row: f"{hypot(*row.disturbance_enu_m_s2):.1f} m/s2", right=True),
    Column("nearest", 10, 175, _nearest, right=True),
)


def columns_for(width: int) -> list[Column]:
    """The columns for a terminal of this width; at least those for 80."""
    return [column for column in COLUMNS if width >= column.from_columns]


def cells(row: VehicleRow, columns: Sequence[Column]) -> list[str]:
    """One text for each column, none wider than its column."""
    return [_cut(printable(column.text(row)), column.width) for column in columns]


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 1]}…"


def note(row: VehicleRow) -> str:
    """That the vehicle is silent, else its health flags, else its last event; "" where there is none of these."""
    if row.silent:
        return f"SILENT for {duration_text(row.age_s)}"
    if row.flags:
        return printable("; ".join(f"{flag}: {FLAG_TEXTS[flag]}" for flag in row.flags))
    return printable(str(row.last_event or ""))


def duration_text(age_s: float) -> str:
    if not isfinite(age_s) or age_s >= 1e5:
        return "never"
    return f"{age_s * 1000:.0f} ms" if age_s < 1.0 else f"{age_s:.1f} s"


def by_fleet(table: Sequence[VehicleRow]) -> Iterator[tuple[str, list[VehicleRow]]]:
    """A heading and the rows of each fleet; rows come sorted by fleet."""
    for fleet, rows in groupby(table, key=lambda row: row.fleet):
        of_fleet = list(rows)
        silent = [row.vehicle_id for row in of_fleet if row.silent]
        open_ = [row.vehicle_id for row in of_fleet if row.network.security == "none"]
        heading = f"fleet {fleet}, {count(len(of_fleet))}" + (f", SILENT: {id_list(silent)}" if silent else "")
        yield heading + (f", UNSECURED (strangers can command): {id_list(open_)}" if open_ else ""), of_fleet


def plain_lines(table: Sequence[VehicleRow], width: int) -> Iterator[str]:
    """For files, pipes and machines without rich: a table and the notes of each fleet. Notes are not cut."""
    columns = columns_for(width)
    if not table:
        yield "no vehicle has reported yet"
    for heading, rows in by_fleet(table):
        yield heading
        yield _line([column.name for column in columns], columns)
        for row in rows:
            yield _line(cells(row, columns), columns)
        for row in rows:
            if text := note(row):
                yield f"  {row.vehicle_id}: {text}"


def _line(texts: Sequence[str], columns: Sequence[Column]) -> str:
    padded = (
        text.rjust(column.width) if column.right else text.ljust(column.width)
        for text, column in zip(texts, columns, strict=True)
    )
    return SEPARATOR.join(padded).rstrip()
