"""A snapshot as lines of text for one width, and for one height where it is a terminal's. Pure.

Columns are designed for 80, 120 and 200 characters. A wider terminal shows more of them; the column `event` takes the rest.
Where not all vehicles fit, those with problems come first and the others take turns.
"""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import combinations
from math import inf, isfinite
from typing import NamedTuple

from companion.geometry.formations import separation_distance_m
from companion.ground.answers import count, id_list
from companion.monitor.api import FleetView, Snapshot, VehicleView
from companion.monitor.vehicle_view import advice_of, fresh_position_enu_m, is_old
from companion.types.code_table import code_table
from companion.types.notices import Code
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


@dataclass(frozen=True, slots=True)
class TableRow:
    """A vehicle, its nearest other one by name and distance ("-" if unknown) and what is wrong with it."""

    vehicle: VehicleView
    fleet_size: int
    nearest: str
    problems: tuple[VehicleProblem, ...]


@dataclass(frozen=True, slots=True)
class FleetRows:
    """A fleet, its rows by vehicle id, and its smallest separation with the two vehicles, among those that report."""

    view: FleetView
    rows: tuple[TableRow, ...]
    smallest: tuple[float, int, int] | None


class VehicleProblem(NamedTuple):
    """Of one vehicle; the worst sorts first. `on_ground` is true for what only keeps it from flying."""

    on_ground: bool
    rank: int
    code: str
    text: str
    advice: str  # what the operator should do; "" where nothing is known of the code


SILENT = "SILENT"
_RANKS = {flag: rank for rank, flag in enumerate(code_table().worst_first)}


def fleets(snapshot: Snapshot) -> Iterator[FleetRows]:
    """Distances are in the metric of `separation_m`, between vehicles whose positions are not old."""
    for view in snapshot.fleets:
        vehicles = [vehicle for vehicle in snapshot.vehicles if vehicle.fleet == view.name]
        known = [
            (vehicle.vehicle_id, place_enu_m)
            for vehicle in vehicles
            if not vehicle.silent and (place_enu_m := fresh_position_enu_m(vehicle)) is not None
        ]
        pairs = [(separation_distance_m(a, b), i, j) for (i, a), (j, b) in combinations(known, 2)]
        nearest: dict[int, tuple[float, int]] = {}
        for distance_m, one, other in sorted(pairs, reverse=True):  # the last one that stays is the nearest
            nearest[one], nearest[other] = (distance_m, other), (distance_m, one)
        size = len(vehicles) + len(view.missing_ids)
        rows = [TableRow(v, size, _nearest(v, nearest.get(v.vehicle_id)), problems_of(v)) for v in vehicles]
        yield FleetRows(view, tuple(rows), min(pairs, default=None))


def _nearest(vehicle: VehicleView, on_the_ground: tuple[float, int] | None) -> str:
    """As the vehicle itself sees it while it flies in formation, with traffic; else from the positions reported.

    ! while the separation filter changes the command because of it.
    """
    if vehicle.silent:
        return NONE
    if seen := vehicle.nearest:
        return f"{'!' if seen.changed_m_s2 > 0.0 else ''}{seen.name}:{metres_text(seen.distance_m)}"
    return f"{on_the_ground[1]}:{metres_text(on_the_ground[0])}" if on_the_ground else NONE


def problems_of(vehicle: VehicleView) -> tuple[VehicleProblem, ...]:
    """The worst first. Of a silent vehicle nothing else is known."""
    if vehicle.silent:
        text = "no report any more; all that is known of it is old"
        return (VehicleProblem(False, -1, SILENT, text, advice_of(Code.NO_REPORT)),)
    flags = sorted(
        VehicleProblem(False, _RANKS[flag.code], flag.code, flag.text, flag.advice) for flag in vehicle.flags
    )
    lacks = [(code, text) for code, _, text in (lack.partition(": ") for lack in vehicle.lacks)]
    unranked = len(_RANKS)
    return (
        *flags,
        *(VehicleProblem(True, _RANKS.get(code, unranked), code, text, advice_of(code)) for code, text in lacks),
    )


def _heading_parts(fleet: FleetRows) -> list[str]:
    """What matters first. Parts for one or more lines; capitals mark what needs attention."""
    view, vehicles = fleet.view, [row.vehicle for row in fleet.rows]
    silent = [vehicle.vehicle_id for vehicle in vehicles if vehicle.silent]
    open_ = [vehicle.vehicle_id for vehicle in vehicles if vehicle.network.security == "none"]
    holders = sorted({vehicle.holder for vehicle in vehicles if vehicle.holder and not vehicle.silent})
    parts = [f"fleet {view.name}: {count(len(vehicles))}"]
    if silent:
        parts.append(f"SILENT: {id_list(silent)}")
    if view.missing_ids:
        parts.append(f"NEVER HEARD: {id_list(view.missing_ids)}")
    if fleet.smallest:
        distance_m, one, other = fleet.smallest
        parts.append(f"smallest separation {distance_m:.2f} m ({one}, {other})")
    parts.append(f"leader {', '.join(map(str, view.leader_ids))}" if view.leader_ids else "NO LEADER")
    if holders:
        parts.append(f"operator {printable(', '.join(holders))}")
    if open_:
        parts.append(f"UNSECURED (strangers can command): {id_list(open_)}")
    return parts


def page(snapshot: Snapshot, width: int) -> list[Line]:
    """All of it, for a file, a pipe, or a terminal that is high enough."""
    return [shown for fleet in fleets(snapshot) for shown in _fleet(fleet, max(width, NARROWEST))]


def fit_page(snapshot: Snapshot, width: int, height: int, now_s: float) -> list[Line]:
    """At most `height` lines. `now_s`: any clock; it turns the part that is shown."""
    whole = page(snapshot, width)
    if len(whole) <= height:
        return whole
    width, all_fleets = max(width, NARROWEST), list(fleets(snapshot))
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
    return cut(text, width)


def _cut_notes(notes: list[Line], room: int) -> list[Line]:
    if len(notes) <= room:
        return notes
    return [*notes[: room - 1], Line(f"  … {len(notes) - room + 1} more lines: enlarge the terminal", Style.QUIET)][
        : max(0, room)
    ]


def _heading(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Parts of the heading, as many on a line as fit."""
    text = ""
    for part in _heading_parts(fleet):
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
    found: dict[VehicleProblem, list[int]] = {}
    for row in fleet.rows:
        for problem in row.problems:
            found.setdefault(problem, []).append(row.vehicle.vehicle_id)
    for problem, vehicle_ids in sorted(found.items()):
        style = Style.ALARM if problem.code == SILENT else Style.WARNING
        yield from _wrapped(f"{problem.code}, {id_list(vehicle_ids)}: {problem.text}", "  ", width, style)
        if problem.advice:
            yield from _wrapped(f"do: {problem.advice}", "    ", width, Style.PLAIN)


def _events(fleet: FleetRows, width: int) -> Iterator[Line]:
    """Each last event once, with its vehicles."""
    vehicle_ids: dict[str, list[int]] = {}
    for vehicle in (row.vehicle for row in fleet.rows):
        if vehicle.last_event and not vehicle.silent:
            vehicle_ids.setdefault(vehicle.last_event, []).append(vehicle.vehicle_id)
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


def _flag(row: TableRow) -> str:
    """The worst one and how many others; of a silent vehicle what it was when it last reported."""
    if row.vehicle.silent:
        return f"was {row.vehicle.phase}{', armed' if row.vehicle.armed else ''}"
    if not row.problems:
        return NONE
    others = f" +{len(row.problems) - 1}" if len(row.problems) > 1 else ""
    worst = row.problems[0].code
    return worst + others if len(worst + others) <= FLAG_WIDTH else worst


def _live(text: Callable[[VehicleView], str]) -> Callable[[TableRow], str]:
    """A silent vehicle has no value that holds now."""
    return lambda row: NONE if row.vehicle.silent else text(row.vehicle)


def _of_fresh_position(text: Callable[[VehicleView], str]) -> Callable[[TableRow], str]:
    """An old position has no value that holds now either."""
    return _live(lambda vehicle: NONE if is_old(vehicle) else text(vehicle))


def _position(vehicle: VehicleView) -> str:
    return " ".join(f"{component_m:z.1f}" for component_m in vehicle.position_enu_m or ())


def _error(vehicle: VehicleView) -> str:
    return NONE if vehicle.error_to_slot_m is None else metres_text(vehicle.error_to_slot_m)


def _age(row: TableRow) -> str:
    vehicle = row.vehicle
    age_s = vehicle.age_s if vehicle.silent else vehicle.data_age_s
    return duration_text(inf if age_s is None else age_s)


def _battery(vehicle: VehicleView) -> str:
    return NONE if vehicle.battery_percent is None else f"{vehicle.battery_percent:.0f}%"


def _estimator(vehicle: VehicleView) -> str:
    return NONE if vehicle.position_error_m is None else metres_text(vehicle.position_error_m[0])


FLAG_WIDTH = 20
COLUMNS = (
    Column("id", 3, 0, lambda row: str(row.vehicle.vehicle_id), right=True),
    Column("phase", 9, 0, lambda row: SILENT if row.vehicle.silent else row.vehicle.phase),
    Column("mode", 12, 80, _live(lambda vehicle: vehicle.mode)),
    Column("armed", 5, 42, _live(lambda vehicle: "armed" if vehicle.armed else NONE)),
    Column("batt", 4, 47, _live(_battery), right=True),
    Column("error", 6, 60, _live(_error), right=True),
    Column("age", 5, 53, _age, right=True),
    Column("nearest", 8, 69, lambda row: row.nearest, right=True),
    Column("PrC", 3, 84, _live(lambda vehicle: str(vehicle.prc)), right=True),
    Column("formation", 13, 98, _live(lambda vehicle: vehicle.formation)),
    Column("Hz", 4, 103, _live(lambda vehicle: f"{vehicle.timing.rate_hz:.1f}"), right=True),
    Column("late", 5, 109, _live(lambda vehicle: duration_text(vehicle.timing.late_p99_ms / 1e3)), right=True),
    Column(
        "peers",
        5,
        115,
        lambda row: _live(lambda vehicle: f"{len(vehicle.peers)}/{row.fleet_size - 1}")(row),
        right=True,
    ),
    Column("rej", 4, 120, _live(lambda vehicle: count_text(vehicle.rejected)), right=True),
    Column("position", 21, 142, _of_fresh_position(_position), right=True),
    Column("sigma", 5, 148, _of_fresh_position(_estimator), right=True),
    Column("ref", 7, 156, _live(lambda vehicle: vehicle.reference), right=True),
    Column("flag", FLAG_WIDTH, 0, _flag),
)
EVENT_FROM_COLUMNS = 185


def columns_for(width: int) -> list[Column]:
    """The columns for a terminal of this width; on a wide one the last event takes the rest of it."""
    shown = [column for column in COLUMNS if width >= column.from_columns]
    if width >= EVENT_FROM_COLUMNS:
        shown.append(
            Column(
                "event",
                width - table_width(shown) - len(SEPARATOR),
                EVENT_FROM_COLUMNS,
                lambda row: row.vehicle.last_event or NONE,
            )
        )
    return shown


def table_width(columns: Sequence[Column]) -> int:
    return sum(column.width + len(SEPARATOR) for column in columns) - len(SEPARATOR)


def cells(row: TableRow, columns: Sequence[Column]) -> list[str]:
    """One text for each column, none wider than its column."""
    return [cut(printable(column.text(row)), column.width) for column in columns]


def line(texts: Sequence[str], columns: Sequence[Column]) -> str:
    """The texts as one line of the table."""
    padded = (
        text.rjust(column.width) if column.right else text.ljust(column.width)
        for text, column in zip(texts, columns, strict=True)
    )
    return SEPARATOR.join(padded).rstrip()


def cut(text: str, width: int) -> str:
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
