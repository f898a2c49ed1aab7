"""The flights without noise in a table: one row a setting, one column a shape."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.study.cases import Figures
from sitl.study.settings import SETTINGS, Setting

WIDTH = 26


def in_a_table(flights: Sequence[Figures], shapes: Sequence[str]) -> str:
    """In each cell: settled after, and the largest and smallest distance of neighbours wanted one spacing apart."""
    rows = [f"{'':<28}" + "".join(f"{shape:>{WIDTH}}" for shape in shapes)]
    rows += [
        f"{setting.label:<28}" + "".join(f"{cell:>{WIDTH}}" for cell in cells_of(flights, setting, shapes))
        for setting in SETTINGS
    ]
    return "\n".join(row.rstrip() for row in rows)


def cells_of(flights: Sequence[Figures], setting: Setting, shapes: Sequence[str]) -> tuple[str, ...]:
    """One for each shape; where a shape was flown twice the first flight counts."""
    flown = {f.shape: f for f in reversed(flights) if f.setting == setting.label}
    return tuple(_cell(flown[shape]) for shape in shapes)


def _cell(figures: Figures) -> str:
    settled = f"{figures.settle_s:.1f} s" if figures.settle_s is not None else f"over {figures.duration_s:.0f} s"
    return f"{settled}, {figures.largest_m:.2f}/{figures.smallest_m:.2f} m"
