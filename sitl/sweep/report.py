"""The results of a sweep as text: sweep.csv, and the table in the terminal."""

from __future__ import annotations

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from msgspec.structs import astuple, fields

from sitl.sweep.flights import FlightFigures, SeededFlight
from sitl.sweep.points import Axis, Point, Value
from sitl.sweep.statistics import Combination, Spread, Sweep

MOST_ROWS = 60  # rows of the table; sweep.json holds all combinations
MEANING = "median (5-95 percent); largest and smallest distance are of neighbours; settled to 10 cm"
NEVER = "never"
NOTHING = "-"


@dataclass(frozen=True, slots=True)
class Row:
    """One flight and its figures."""

    flight: SeededFlight
    figures: FlightFigures


def write_csv(path: Path, axes: Sequence[Axis], points: Sequence[Point], rows: Sequence[Row]) -> None:
    """Write one row per flight, with the values as written on the command line."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*(axis.key for axis in axes), "seed", *(field.name for field in fields(FlightFigures))])
        for row in rows:
            values = [choice.text for choice in points[row.flight.point].choices]
            figures = ["" if figure is None else figure for figure in astuple(row.figures)]
            writer.writerow([*values, row.flight.seed, *figures])


def table_text(sweep: Sweep) -> str:
    """The table of medians with, in brackets, the 5 and 95 percentiles."""
    keys = list(sweep.vary)
    head = [*map(short_name, keys), "flights", "settled", "settled [s]", "largest [m]", "smallest [m]"]
    head += ["any two [m]", "final error [m]"]
    shown = sweep.combinations[:MOST_ROWS]
    columns = list(zip(head, *(_cells(one) for one in shown), strict=True))
    widths = [max(map(len, column)) for column in columns]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*columns, strict=True)
    ]
    return "\n".join([heading(sweep), MEANING, *lines, *_rest(sweep)])


def short_name(key: str) -> str:
    """ "stand_in.airframe.mass_kg" -> "airframe.mass_kg"."""
    return ".".join(key.split(".")[-2:])


def heading(sweep: Sweep) -> str:
    vehicles = "1 vehicle" if sweep.vehicles == 1 else f"{sweep.vehicles} vehicles"
    stopped = "" if sweep.complete else "; stopped before the end"
    return f"{sweep.scenario}: {sweep.flights} flights of {vehicles}, {sweep.seconds:g} s each{stopped}"


def _rest(sweep: Sweep) -> Iterator[str]:
    if len(sweep.combinations) > MOST_ROWS:
        yield f"and {len(sweep.combinations) - MOST_ROWS} more combinations, see sweep.json"


def _cells(one: Combination) -> list[str]:
    return [
        *map(value_text, one.values.values()),
        str(one.flights),
        f"{100.0 * one.settled_share:.0f} %",
        _spread(one.settle_s, 1, NEVER),
        _spread(one.largest_neighbouring_distance_m, 2, NOTHING),
        _spread(one.smallest_neighbouring_distance_m, 2, NOTHING),
        _spread(one.smallest_distance_m, 2, NOTHING),
        _spread(one.final_error_m, 3, NOTHING),
    ]


def value_text(value: Value) -> str:
    """The value as YAML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _spread(figure: Spread, digits: int, nothing: str) -> str:
    p5, median, p95 = (
        nothing if value is None else f"{value:.{digits}f}" for value in (figure.p5, figure.median, figure.p95)
    )
    return median if p5 == median == p95 else f"{median} ({p5}-{p95})"
