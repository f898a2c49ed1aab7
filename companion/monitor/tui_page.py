"""The whole picture as lines of text for one width, and for one height where it is a terminal's. Pure.

Columns are designed for 80, 120 and 200 characters. A wider terminal shows more of them; the column `event` takes the rest.
Where not all vehicles fit, those with problems come first and the others take turns.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import isfinite

from companion.ground.answers import id_list
from companion.ground.fleet_state import ReportedVehicle, formation_text, reference_text
from companion.monitor.tui_rows import NO_MEMBERS, SILENT, FleetRows, Members, TableRow, fleets, group_problems, heading
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


def page(vehicles: Sequence[ReportedVehicle], width: int, members: Members = NO_MEMBERS) -> list[Line]:
    """All of it, for a file, a pipe, or a terminal that is high enough."""
    return [shown for fleet in fleets(vehicles, members) for shown in _fleet(fleet, max(width, NARROWEST))]


def fit_page(
    vehicles: Sequence[ReportedVehicle], width: int, height: int, now_s: float, members: Members = NO_MEMBERS
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
    for problem, vehicle_ids in group_problems(of_vehicles):
        style = Style.ALARM if problem.code == SILENT else Style.WARNING
        yield from _wrapped(f"{problem.code}, {id_list(vehicle_ids)}: {problem.text}", "  ", width, style)
        if problem.advice:
            yield from _wrapped(f"do: {problem.advice}", "    ", width, Style.PLAIN)


def _events(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Each last event once, with its vehicles."""
    vehicle_ids: dict[str, list[int]] = {}
    for vehicle in (row.vehicle for row in fleet.rows):
        if vehicle.status.last_event and not vehicle.silent:
            vehicle_ids.setdefault(str(vehicle.status.last_event), []).append(vehicle.vehicle_id)
    for event, ids in vehicle_ids.items():
        yield from _wrapped(f"{id_list(ids)}: {event}", "  ", width, Style.QUIET)


def _wrapped(text: str, indent: str, width: int, style: Style) -> Iterator[Line]:
    for part in textwrap.wrap(
        printable(text), width, initial_indent=indent, subsequent_indent=indent + "  ", break_on_hyphens=False
    ):
        yield Line(part, style)


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
    return "SILENT" if row.vehicle.silent else row.vehicle.status.phase


def _flag(row: TableRow) -> str:
    """The worst one and how many others; of a silent vehicle what it was when it last reported."""
    if row.vehicle.silent:
        return f"was {row.vehicle.status.phase}{', armed' if row.vehicle.status.autopilot.armed else ''}"
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
    return lambda row: NONE if row.vehicle.has_old_position else text(row)


def _position(row: TableRow) -> str:
    return " ".join(f"{x:z.1f}" for x in row.vehicle.status.motion.position_enu_m)


def _error(row: TableRow) -> str:
    error_m = row.vehicle.error_to_slot_m
    return NONE if error_m is None else metres_text(error_m)


def _battery(row: TableRow) -> str:
    percent = row.vehicle.status.autopilot.battery_percent
    return NONE if percent is None else f"{percent:.0f}%"


def _estimator(row: TableRow) -> str:
    error = row.vehicle.status.motion.position_error
    return NONE if error is None else metres_text(error.horizontal_m)


def _event(row: TableRow) -> str:
    return str(row.vehicle.status.last_event or NONE)


FLAG_WIDTH = 20
COLUMNS = (
    Column("id", 3, 0, lambda row: str(row.vehicle.vehicle_id), right=True),
    Column("phase", 9, 0, _phase),
    Column("mode", 12, 80, _live(lambda row: row.vehicle.status.autopilot.mode_name)),
    Column("armed", 5, 42, _live(lambda row: "armed" if row.vehicle.status.autopilot.armed else NONE)),
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
    Column("PrC", 3, 84, _live(lambda row: str(row.vehicle.status.leadership.prc)), right=True),
    Column("formation", 13, 98, _live(lambda row: formation_text(row.vehicle.status))),
    Column("Hz", 4, 103, _live(lambda row: f"{row.vehicle.report.timing.rate_hz:.1f}"), right=True),
    Column("late", 5, 109, _live(lambda row: duration_text(row.vehicle.report.timing.late_us.p99 / 1e6)), right=True),
    Column(
        "peers",
        5,
        115,
        _live(lambda row: f"{len(row.vehicle.status.neighbourhood.peers)}/{row.fleet_size - 1}"),
        right=True,
    ),
    Column("rej", 4, 120, _live(lambda row: count_text(row.vehicle.rejected)), right=True),
    Column("position", 21, 142, _live(_of_fresh_position(_position)), right=True),
    Column("sigma", 5, 148, _live(_of_fresh_position(_estimator)), right=True),
    Column("ref", 7, 156, _live(lambda row: reference_text(row.vehicle.status)), right=True),
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
