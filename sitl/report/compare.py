"""The same scenario flown with one law after another: one table, one figure, comparison.json."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from msgspec import Struct

from sitl.report.metrics import FormationFlight
from sitl.report.summary import IF_TOO_BUSY, SCHEMA, RunSummary, write_json

BEST = "*"


class ComparisonRow(Struct, frozen=True, kw_only=True):
    """One figure of every law, in the order of the flights. `best` names the laws with the best value."""

    figure: str
    unit: str
    values: dict[str, float | None]
    best: list[str]


class Comparison(Struct, frozen=True, kw_only=True):
    """comparison.json."""

    schema: int = SCHEMA
    scenario: str
    laws: list[str]
    too_busy: list[str]  # laws that the machine was too busy to fly in real time
    rows: list[ComparisonRow]


def compare(summaries: Sequence[RunSummary]) -> Comparison:
    """`summaries` are of one scenario, each with another law and with a formation."""
    rows = [
        _row(f"largest distance {pair}", "m", {s.law: (s.max_distance_m or {}).get(pair) for s in summaries})
        for pair in summaries[0].pairs
    ]
    rows += [
        _row("smallest distance", "m", {s.law: s.smallest_distance_m for s in summaries}, largest_is_best=True),
        _settling_row(summaries),
        _row("final error", "m", {s.law: s.final_error_m for s in summaries}),
    ]
    for figure, largest in (
        ("largest tracking error", {s.law: _largest(v.tracking_error_m for v in s.vehicles) for s in summaries}),
        ("largest while following", {s.law: _largest(v.behind_leader_m for v in s.vehicles) for s in summaries}),
    ):
        if any(value is not None for value in largest.values()):
            rows.append(_row(figure, "m", largest))
    return Comparison(
        scenario=summaries[0].scenario,
        laws=[s.law for s in summaries],
        too_busy=[s.law for s in summaries if s.overload],
        rows=rows,
    )


def _settling_row(summaries: Sequence[RunSummary]) -> ComparisonRow:
    """About a moving reference a law may never settle: then the largest error of the second half is compared."""
    settles = any(s.settle_s is not None or not s.reference_moves for s in summaries)
    if settles:
        return _row("settled to 10 cm", "s", {s.law: s.settle_s for s in summaries})
    return _row("largest error", "m", {s.law: s.largest_error_m for s in summaries})


def _largest(values: Iterable[float | None]) -> float | None:
    """The largest known value; a vehicle that only led has no error behind a leader."""
    return max((value for value in values if value is not None), default=None)


def _row(figure: str, unit: str, values: dict[str, float | None], largest_is_best: bool = False) -> ComparisonRow:
    known = [value for value in values.values() if value is not None]
    best = (max(known) if largest_is_best else min(known)) if known else None
    winners = [law for law, value in values.items() if best is not None and value == best]
    return ComparisonRow(figure=figure, unit=unit, values=values, best=winners)


def in_a_table(comparison: Comparison) -> str:
    """The printed table; the best value of each row is marked."""
    names = [f"{row.figure} [{row.unit}]" for row in comparison.rows]
    first = max(len(name) for name in [*names, comparison.scenario])
    lines = [f"{comparison.scenario:<{first}}" + "".join(f"{law:>14}" for law in comparison.laws)]
    for name, row in zip(names, comparison.rows, strict=True):
        cells = (_cell(row, law) for law in comparison.laws)
        lines.append((f"{name:<{first}}" + "".join(f"{cell:>14}" for cell in cells)).rstrip())
    lines.append(f"{BEST} best")
    if comparison.too_busy:
        lines.append(f"the machine was too busy for real time under {', '.join(comparison.too_busy)}: {IF_TOO_BUSY}")
    return "\n".join(lines)


def _cell(row: ComparisonRow, law: str) -> str:
    value = row.values[law]
    if value is None:
        return "never  "
    digits = 1 if row.unit == "s" else 3
    return f"{value:.{digits}f} {BEST if law in row.best else ' '}"


def write_comparison(folder: Path, comparison: Comparison, flights: Sequence[FormationFlight]) -> None:
    """comparison.json and comparison.png."""
    from sitl.report.plots import (
        save_comparison,  # matplotlib is slow to import; not before the flights are over
    )

    write_json(folder / "comparison.json", comparison)
    if flights:
        save_comparison(folder / "comparison.png", flights, comparison.scenario)
