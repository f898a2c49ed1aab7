"""Plot of a sweep: its figures over one numeric key, or one row per combination where no number was varied.

Every curve has its own line style, marker and colour, so that the plot is readable in greyscale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from companion.report.plotting import (
    COLOURS,
    DPI,
    GUIDE,
    curve_look,
    dress,
    marker_look,
    put_legend_below,
    titled_figure,
)
from sitl.sweep.points import Axis, Value
from sitl.sweep.report import heading, short_name, value_text
from sitl.sweep.statistics import Combination, Spread, Sweep

MOST_CURVES, MOST_POINTS = 12, 40  # more are not legible
WIDE_RATIO = 50.0  # keys with a larger ratio of values get a logarithmic scale
MOST_LETTERS = 150  # characters in a line of the legend
BAND_ALPHA = 0.13
PERCENT = (-4.0, 104.0)
A_LITTLE_MORE = 1.06
LEAST_SPAN_M = 0.1
NEVER_LOOK: dict[str, Any] = {"ha": "right", "va": "bottom", "fontsize": 9, "color": "#606060"}
SHARE, SETTLE, ERROR = "settled_share", "settle_s", "final_error_m"

PANELS = {
    SHARE: "flights that settled to 10 cm [%]",
    SETTLE: "time to settle to 10 cm [s]",
    ERROR: "final error [m]",
    "largest_neighbouring_distance_m": "largest distance of neighbours [m]",
    "smallest_neighbouring_distance_m": "smallest distance of neighbours [m]",
    "smallest_distance_m": "smallest distance of any two [m]",
}


@dataclass(frozen=True, slots=True)
class Curve:
    """Combinations that differ only in the key along the axis."""

    label: str
    combinations: list[Combination]


def save_sweep(path: Path, sweep: Sweep, axes: Sequence[Axis]) -> None:
    along = _along(axes)
    figure = _curves(sweep, along.key) if along else _points(sweep)
    figure.savefig(path, dpi=DPI)


def _along(axes: Sequence[Axis]) -> Axis | None:
    """The numeric key with the most values; the first where several have as many."""
    return max((axis for axis in axes if axis.is_numeric), key=lambda axis: len(axis.choices), default=None)


# ---------------------------------------------------------------- over a number


def _curves(sweep: Sweep, key: str) -> Figure:
    curves = curves_of(sweep, key)
    drawn = curves[:MOST_CURVES]
    shown = [one for curve in drawn for one in curve.combinations]
    figure = _figure(sweep, (12.6, 7.4), _omitted(len(drawn), len(curves), "curves"))
    panels: dict[str, Axes] = dict(zip(PANELS, figure.subplots(2, 3, sharex=True).ravel(), strict=True))
    for name, axes in panels.items():
        for index, curve in enumerate(drawn):
            _draw_curve(axes, key, curve, name, index, sweep.seconds)
        axes.set_title(PANELS[name], fontsize=10)
        dress(axes)
        _scale(axes, sweep.vary[key])
        axes.set_ylim(_limits(shown, name, sweep.seconds))
    for axes in list(panels.values())[3:]:
        axes.set_xlabel(key)
    if _some_never_settled(shown):
        panels[SETTLE].axhline(sweep.seconds, **GUIDE)
        panels[SETTLE].annotate("never", (1.0, sweep.seconds), xycoords=("axes fraction", "data"), **NEVER_LOOK)
    _legend_below(figure, panels[SHARE], len(drawn))
    return figure


def _legend_below(figure: Figure, axes: Axes, curves: int) -> None:
    if curves < 2:
        return
    _, labels = axes.get_legend_handles_labels()
    put_legend_below(figure, axes, max(1, min(curves, MOST_LETTERS // (max(map(len, labels)) + 10))))


def curves_of(sweep: Sweep, key: str) -> list[Curve]:
    """Curves in the order of the combinations, each sorted by the key."""
    curves: dict[str, list[Combination]] = {}
    for one in sweep.combinations:
        others = {other: value for other, value in one.values.items() if other != key}
        curves.setdefault(_label(others) or "all flights", []).append(one)
    return [Curve(label, sorted(own, key=lambda one: one.values[key])) for label, own in curves.items()]


def _draw_curve(axes: Axes, key: str, curve: Curve, name: str, index: int, seconds: float) -> None:
    values = np.array([one.values[key] for one in curve.combinations], dtype=float)
    low, middle, high = np.array([_spread(one, name, seconds) for one in curve.combinations], dtype=float).T
    look = curve_look(index)
    axes.fill_between(values, low, high, color=look["color"], alpha=BAND_ALPHA, linewidth=0)
    for edge in (low, high):
        axes.plot(values, edge, alpha=0.7, **look | {"linewidth": 0.7})
    axes.plot(values, middle, label=curve.label, **marker_look(index) | look)


def _scale(axes: Axes, values: Sequence[Value]) -> None:
    numbers = [float(value) for value in values]
    if min(numbers) > 0.0 and max(numbers) / min(numbers) > WIDE_RATIO:
        axes.set_xscale("log")
    elif all(isinstance(value, int) for value in values):
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))


# ---------------------------------------------------------------- one row per combination


def _points(sweep: Sweep) -> Figure:
    """One row per combination, the first at the top."""
    drawn = sweep.combinations[:MOST_POINTS]
    labels = [_label(one.values) or "all flights" for one in drawn]
    figure = _figure(
        sweep, (13.0, 3.4 + 0.5 * len(drawn)), _omitted(len(drawn), len(sweep.combinations), "combinations")
    )
    panels: dict[str, Axes] = dict(zip(PANELS, figure.subplots(2, 3, sharey=True).ravel(), strict=True))
    for name, axes in panels.items():
        for row, one in enumerate(drawn):
            low, middle, high = _spread(one, name, sweep.seconds)
            axes.plot([low, high], [row, row], color=COLOURS[row % len(COLOURS)], linewidth=2.2, alpha=0.6)
            axes.plot([middle], [row], **marker_look(row))
        axes.set_title(PANELS[name], fontsize=10)
        dress(axes)
        axes.set_yticks(range(len(drawn)), labels)
        axes.set_ylim(len(drawn) - 0.5, -0.5)
        axes.set_xlim(_limits(drawn, name, sweep.seconds))
    if _some_never_settled(drawn):
        panels[SETTLE].axvline(sweep.seconds, **GUIDE)
        panels[SETTLE].annotate("never", (sweep.seconds, 1.0), xycoords=("data", "axes fraction"), **NEVER_LOOK)
    return figure


# ---------------------------------------------------------------- for both


def _figure(sweep: Sweep, size_in: tuple[float, float], left_out: str) -> Figure:
    return titled_figure(*size_in, f"{heading(sweep)}\nmedian, and from 5 to 95 percent of flights{left_out}")


def _omitted(drawn: int, of: int, what: str) -> str:
    return f"; {drawn} of {of} {what}, all are in sweep.json" if drawn < of else ""


def _label(values: dict[str, Value]) -> str:
    return ", ".join(f"{short_name(key)} {value_text(value)}" for key, value in values.items())


def _spread(one: Combination, name: str, seconds: float) -> tuple[float, float, float]:
    """Low, middle and high. A share has no spread. Unsettled flights are drawn at the end of the flight; NaN is not drawn."""
    if name == SHARE:
        return (100.0 * one.settled_share,) * 3
    spread: Spread = getattr(one, name)
    missing = seconds if name == SETTLE else nan
    low, middle, high = (missing if value is None else value for value in (spread.p5, spread.median, spread.p95))
    return low, middle, high


def _limits(drawn: Sequence[Combination], name: str, seconds: float) -> tuple[float, float]:
    """Limits of the panel, with a smallest span so that differences of millimetres do not appear large."""
    if name == SHARE:
        return PERCENT
    if name == SETTLE:
        return (0.0, seconds * A_LITTLE_MORE)
    figures = np.array([_spread(one, name, seconds) for one in drawn])
    if np.isnan(figures).all():  # a single vehicle has no distances
        return (0.0, 1.0)
    low, high = float(np.nanmin(figures)), float(np.nanmax(figures))
    if name == ERROR:
        return (0.0, max(high * A_LITTLE_MORE, LEAST_SPAN_M))
    margin_m = max(0.06 * (high - low), (LEAST_SPAN_M - (high - low)) / 2.0)
    return (low - margin_m, high + margin_m)


def _some_never_settled(drawn: Sequence[Combination]) -> bool:
    return any(one.settle_s.p95 is None for one in drawn)
