"""The results of a comparison as files and text: compare.csv, compare.parquet, compare.json, and the tables in the terminal."""

from __future__ import annotations

import csv
import platform
from collections import Counter
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from msgspec import Struct
from msgspec.structs import asdict

from companion import __version__
from sitl.batch.flight import LEFT_OUT
from sitl.compare.plan import Plan
from sitl.compare.statistics import (
    FEWEST_SEEDS,
    MEANINGS,
    ByCell,
    CellSummary,
    Checked,
    FlownFlight,
    MedianInterval,
    Winner,
    by_cell,
    checks,
    summaries,
    winners,
)

SCHEMA = 1
MOST_ROWS = 60  # rows of the table in the terminal
SHOWN = ("settle_s", "smallest_distance_m", "rms_m", "effort_m_s2")
NEVER, NOTHING = "never", "–"
Row = dict[str, Any]
"""One flight, by the columns of compare.csv."""
AGENTS, BATCH = "agents", "batch"


class Compared(Struct, frozen=True, kw_only=True):
    """Content of compare.json. `complete` is false after a stop; then some flights are missing.

    `laws`: the SHA-256 of each law that is a file. `settings`: those of --set, of all places.
    `command`: what gives the same figures again.
    """

    schema: int = SCHEMA
    command: str
    versions: dict[str, str]
    laws: dict[str, str | None]
    settings: list[str]
    seconds: float
    seeds: int
    flights: int
    planned: int
    complete: bool
    cells: list[CellSummary]
    winners: list[Winner]
    checks: list[Checked]


def compared(command: str, plan: Plan, flown: Sequence[FlownFlight], checked: Sequence[FlownFlight]) -> Compared:
    cells = by_cell(flown)
    return Compared(
        command=command,
        versions=versions(),
        laws={label: section.sha256 for label, section in plan.laws.items()},
        settings=plan.settings,
        seconds=plan.seconds,
        seeds=plan.seeds,
        flights=len(flown),
        planned=len(plan.flights),
        complete=len(flown) == len(plan.flights) and len(checked) == len(plan.check),
        cells=summaries(cells),
        winners=winners(cells),
        checks=checks(cells, checked),
    )


def versions() -> dict[str, str]:
    return {"formation-companion": __version__, "Python": platform.python_version(), "numpy": np.__version__}


def rows_of(flown: Sequence[FlownFlight]) -> list[Row]:
    """One row per flight: the cell, the seed, what flew it, and the figures."""
    return [
        {
            "law": one.flight.cell.law,
            "graph": one.flight.cell.place.graph,
            "vehicles": one.flight.cell.place.vehicles,
            "condition": one.flight.cell.place.condition,
            **dict(varied.split("=", 1) for varied in one.flight.cell.place.varied),
            "seed": one.flight.seed,
            "flown_by": AGENTS if one.flight.by_agents else BATCH,
            **asdict(one.figures),
        }
        for one in flown
    ]


def write_rows(folder: Path, rows: Sequence[Row]) -> None:
    """compare.csv, and compare.parquet where pyarrow is installed."""
    with (folder / "compare.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(rows)
    if find_spec("pyarrow") is None:
        return
    from pyarrow import Table
    from pyarrow.parquet import write_table

    write_table(Table.from_pylist(list(rows)), folder / "compare.parquet")


def report_text(result: Compared, cells: ByCell) -> str:
    """What the terminal shows."""
    vehicles = sorted({cell.place.vehicles for cell in cells})
    sizes = "1 vehicle" if vehicles == [1] else f"{', '.join(map(str, vehicles))} vehicles"
    stopped = "" if result.complete else f"; stopped before the end, {result.planned} were planned"
    heading = f"{result.flights} flights of {sizes}, {result.seconds:g} s each{settings_text(result)}{stopped}"
    parts = [
        heading,
        _table(result.cells),
        "\n".join(failures_text(cells)),
        "\n".join(wins_text(result)),
        "\n".join(checks_text(result.checks)),
        "\n".join(remarks_text(cells)),
    ]
    if by_agents := conditions_by_agents(cells):
        parts.append(f"flown by the agents one by one, not in a batch: {', '.join(by_agents)}")
    parts.append("\n".join(["what a batch leaves out:", *(f"  {line}" for line in LEFT_OUT)]))
    return "\n\n".join(filter(None, parts))


def settings_text(result: Compared) -> str:
    """What --set has changed in all places."""
    return f", all with {', '.join(result.settings)}" if result.settings else ""


def conditions_by_agents(cells: ByCell) -> list[str]:
    """Those whose flights a batch could not fly."""
    return list(dict.fromkeys(cell.place.condition for cell, flown in cells.items() if flown[0].flight.by_agents))


def _table(cells: Sequence[CellSummary]) -> str:
    head = ["place", "law", "flights", "settled", *(MEANINGS[name].label for name in SHOWN)]
    columns = list(zip(head, *(_cells(one) for one in cells[:MOST_ROWS]), strict=True))
    widths = [max(map(len, column)) for column in columns]
    lines = [
        "  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=True)).rstrip()
        for line in zip(*columns, strict=True)
    ]
    more = [f"and {len(cells) - MOST_ROWS} more, see the page"] if len(cells) > MOST_ROWS else []
    return "\n".join(["median (95 % interval)", *lines, *more])


def _cells(one: CellSummary) -> list[str]:
    shown = [interval_text(name, one.figures.get(name)) for name in SHOWN]
    flights = f"{one.flights}, {one.failed} failed" if one.failed else str(one.flights)
    return [one.place, one.law, flights, f"{100.0 * one.settled_share:.0f} %", *shown]


def interval_text(name: str, figure: MedianInterval | None) -> str:
    """ "2.2 (2.1–2.3)"."""
    median, interval = interval_parts(name, figure)
    return f"{median} ({interval})" if interval else median


def interval_parts(name: str, figure: MedianInterval | None) -> tuple[str, str]:
    """Median and interval, "2.2" and "2.1–2.3"; an interval of one value is empty."""
    if figure is None:
        return NOTHING, ""
    low, median, high = (number_text(name, value) for value in (figure.low, figure.median, figure.high))
    return median, "" if low == median == high else f"{low}–{high}"


def number_text(name: str, value: float | None) -> str:
    missing = NEVER if name == "settle_s" else NOTHING
    return missing if value is None else f"{value:.{MEANINGS[name].digits}f}"


def failures_text(cells: ByCell) -> Iterator[str]:
    """One line for each law and place of which a flight has failed: how many, and why the first."""
    for cell, flown in cells.items():
        reasons = [one.figures.failure for one in flown if one.figures.failure is not None]
        if reasons:
            yield f"failed: {cell.law}, {cell.place.name}, {len(reasons)} of {len(flown)} flights: {reasons[0]}"


def remarks_text(cells: ByCell) -> list[str]:
    """Laws that did not fly in arrays, with the reason, once each."""
    found = ((cell.law, one.figures.remark) for cell, flown in cells.items() for one in flown)
    return list(dict.fromkeys(f"{law}: {remark}" for law, remark in found if remark))


def wins_text(result: Compared) -> Iterator[str]:
    """For each figure: in how many places each law is the best one."""
    for name, meaning in MEANINGS.items():
        own = [one for one in result.winners if one.figure == name and one.clear]
        places = sum(one.figure == name for one in result.winners)
        if own:
            counts = ", ".join(f"{law} in {count}" for law, count in Counter(one.law for one in own).most_common())
            others = ", the others are not clear" if len(own) < places else ""
            yield f"best by {meaning.label}: {counts} of {places}{others}"
    if result.seeds < FEWEST_SEEDS:
        yield f"with fewer than {FEWEST_SEEDS} seeds no law is called the best"


def checks_text(made: Sequence[Checked]) -> Iterator[str]:
    """How the agents agree with the batch."""
    if not made:
        return
    flights = len({(one.law, one.place) for one in made})
    agree = sum(one.agrees for one in made)
    yield f"{flights} flights again by the agents: {agree} of {len(made)} figures agree"
    for one in made:
        batch, agents = number_text(one.figure, one.batch), number_text(one.figure, one.agents)
        errors = ", with random errors of its own" if one.random else ""
        if not one.agrees:
            label = MEANINGS[one.figure].label
            yield f"  differs: {one.law}, {one.place}, {label}: batch {batch}, agents {agents}{errors}"
