"""The whole picture as lines of text for one width, and for one height where it is a terminal's. Pure.

Where not all of it fits, vehicles with problems come first and the others take turns.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum

from companion.ground.fleet_status import VehicleRow
from companion.ground.text import id_list
from companion.monitor.terminal.columns import Column, cells, columns_for, line
from companion.monitor.terminal.fleet_rows import NO_MEMBERS, FleetRows, Members, TableRow, fleets, heading
from companion.monitor.terminal.problems import SILENT, grouped
from companion.types.values import printable

NARROWEST = 40
TURN_S = 3.0  # how long one part of the other vehicles is shown
LEAST_ROWS = 3


class Style(StrEnum):
    """How a line may look. Every line reads the same without it."""

    PLAIN = ""
    HEADING = "bold"
    ALARM = "bold red"
    WARNING = "yellow"
    QUIET = "dim"


@dataclass(frozen=True, slots=True)
class Line:
    text: str
    style: Style = Style.PLAIN


def page(vehicles: Sequence[VehicleRow], width: int, members: Members = NO_MEMBERS) -> list[Line]:
    """All of it, for a file, a pipe, or a terminal that is high enough."""
    return [shown for fleet in fleets(vehicles, members) for shown in _fleet(fleet, max(width, NARROWEST))]


def fitted_page(
    vehicles: Sequence[VehicleRow], width: int, height: int, now_s: float, members: Members = NO_MEMBERS
) -> list[Line]:
    """At most `height` lines. `now_s`: any clock; it turns the part that is shown."""
    whole = page(vehicles, width, members)
    if len(whole) <= height:
        return whole
    width, all_fleets = max(width, NARROWEST), list(fleets(vehicles, members))
    lines = []
    share, left = divmod(height, len(all_fleets))
    for number, fleet in enumerate(all_fleets):
        lines += _fitted_fleet(fleet, width, share + (number < left), now_s)
    return lines[:height]


def _fleet(fleet: FleetRows, width: int) -> Iterator[Line]:
    columns = columns_for(width)
    yield from _heading(fleet, width)
    yield _names(columns)
    yield from (_row(row, columns) for row in fleet.rows)
    yield from _notes(fleet, width)
    if columns[-1].name != "event":
        yield from _events(fleet, width)


def _fitted_fleet(fleet: FleetRows, width: int, height: int, now_s: float) -> list[Line]:
    columns = columns_for(width)
    above = [*_heading(fleet, width), _names(columns)]
    notes = list(_notes(fleet, width))
    room = height - len(above)
    in_rows = min(len(fleet.rows), max(LEAST_ROWS, room - len(notes)))
    if in_rows < len(fleet.rows):
        in_rows = max(1, in_rows - 1)  # one line says what is left out
    rows, left_out = _chosen(fleet.rows, in_rows, now_s)
    table = [_row(row, columns) for row in rows]
    if left_out:
        table.append(Line(_left_out(left_out, width), Style.QUIET))
    lines = [*above, *table]
    return lines + _cut_notes(notes, height - len(lines))


def _chosen(rows: Sequence[TableRow], most: int, now_s: float) -> tuple[list[TableRow], list[TableRow]]:
    """(those shown, those left out): first those with problems, then a part of the others that changes with the time."""
    if len(rows) <= most:
        return list(rows), []
    with_problems = [row for row in rows if row.problems]
    others = [row for row in rows if not row.problems]
    first, room = with_problems[:most], max(0, most - len(with_problems))
    parts = [others[i : i + room] for i in range(0, len(others), room)] if room else [[]]
    shown = first + parts[int(now_s / TURN_S) % len(parts)]
    return shown, [row for row in rows if row not in shown]


def _left_out(rows: Sequence[TableRow], width: int) -> str:
    flagged = [row.vehicle.vehicle_id for row in rows if row.problems]
    text = f"  … {len(rows)} more"
    text += f", with flags: {id_list(flagged)}" if flagged else ", without flags"
    return text if len(text) <= width else f"{text[: width - 1]}…"


def _cut_notes(notes: list[Line], room: int) -> list[Line]:
    if len(notes) <= room:
        return notes
    return [*notes[: room - 1], Line(f"  … {len(notes) - room + 1} more lines: enlarge the terminal", Style.QUIET)][
        : max(0, room)
    ]


def _heading(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Parts of the heading, as many on a line as fit."""
    text = ""
    for part in heading(fleet):
        joined = f"{text}, {part}" if text else part
        if text and len(joined) > width:
            yield from _wrapped(text + ",", "", width, Style.HEADING)
            text = "  " + part
        else:
            text = joined
    yield from _wrapped(text, "", width, Style.HEADING)


def _names(columns: Sequence[Column]) -> Line:
    return Line(line([column.name for column in columns], columns), Style.QUIET)


def _row(row: TableRow, columns: Sequence[Column]) -> Line:
    style = Style.ALARM if row.vehicle.silent else Style.WARNING if row.problems else Style.PLAIN
    return Line(line(cells(row, columns), columns), style)


def _notes(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Each problem once, with its vehicles and what to do."""
    of_vehicles = ((row.vehicle.vehicle_id, problem) for row in fleet.rows for problem in row.problems)
    for problem, vehicle_ids in grouped(of_vehicles):
        style = Style.ALARM if problem.code == SILENT else Style.WARNING
        yield from _wrapped(f"{problem.code}, {id_list(vehicle_ids)}: {problem.text}", "  ", width, style)
        if problem.advice:
            yield from _wrapped(f"do: {problem.advice}", "    ", width, Style.PLAIN)


def _events(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Each last event once, with its vehicles."""
    vehicle_ids: dict[str, list[int]] = {}
    for vehicle in (row.vehicle for row in fleet.rows):
        if vehicle.last_event and not vehicle.silent:
            vehicle_ids.setdefault(str(vehicle.last_event), []).append(vehicle.vehicle_id)
    for event, ids in vehicle_ids.items():
        yield from _wrapped(f"{id_list(ids)}: {event}", "  ", width, Style.QUIET)


def _wrapped(text: str, indent: str, width: int, style: Style) -> Iterator[Line]:
    for part in textwrap.wrap(
        printable(text), width, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False
    ):
        yield Line(part, style)
