"""The flights without noise as a table: one row per setting, one column per shape."""

from __future__ import annotations

from collections.abc import Sequence

from sitl.study.cases import Figures
from sitl.study.settings import SETTINGS, Setting

LABEL_WIDTH, WIDTH = 30, 26


def table_text(flights: Sequence[Figures], shapes: Sequence[str]) -> str:
    """The table. Each cell holds the settle time, and the largest and smallest distance of neighbours one spacing apart."""
    rows = [f"{'':<{LABEL_WIDTH}}" + "".join(f"{shape:>{WIDTH}}" for shape in shapes)]
    rows += [
        f"{setting.label:<{LABEL_WIDTH}}"
        + "".join(f" {cell:>{WIDTH - 1}}" for cell in cells_of(flights, setting, shapes))
        for setting in SETTINGS
    ]
    return "\n".join(row.rstrip() for row in rows)


def cells_of(flights: Sequence[Figures], setting: Setting, shapes: Sequence[str]) -> tuple[str, ...]:
    """One cell per shape; where a shape was flown twice, that of the first flight."""
    flown = {f.shape: f for f in reversed(flights) if f.setting == setting.label}
    return tuple(_cell(flown[shape]) for shape in shapes)


def _cell(figures: Figures) -> str:
    settled = f"{figures.settle_s:.1f} s" if figures.settle_s is not None else f"over {figures.duration_s:.0f} s"
    return f"{settled}, {figures.largest_m:.2f}/{figures.smallest_m:.2f} m"
