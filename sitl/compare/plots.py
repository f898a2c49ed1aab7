"""The figures of a comparison, for the page and for a paper: readable in grey, each law with one marker in all of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import log10
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FixedLocator, LogLocator, NullLocator

from companion.report.plotting import COLOURS, MARKERS, dress
from sitl.compare.plan import Place, Plan
from sitl.compare.report import Compared, number_text
from sitl.compare.statistics import ByCell, CellSummary, MedianInterval

MOST_PLACES, MOST_PANELS = 60, 12  # more are not legible; compare.json has all
SETTLE, DISTANCE = "settle_s", "smallest_distance_m"
PANEL_IN = (4.3, 3.5)
SOON_S = 0.5  # an earlier settling is drawn here
NEVER_FACTOR, END_FACTOR = 1.45, 1.9  # of the duration: where unsettled flights are drawn, and the end of the axis
NEVER_ROOM = 0.13  # of the length of the axis: a mark nearer to "never" would touch the word
RC: Any = {"pdf.fonttype": 42, "font.sans-serif": ["DejaVu Sans"]}  # text stays text


@dataclass(frozen=True, slots=True)
class ComparisonFigure:
    """A figure with its title and what it shows."""

    figure: Figure
    title: str
    shows: str


def save_pdf(path: Path, figure: Figure) -> None:
    with matplotlib.rc_context(RC):
        figure.savefig(path, metadata={"CreationDate": None, "Producer": None, "Creator": None})


def figures_of(plan: Plan, cells: ByCell, result: Compared) -> dict[str, ComparisonFigure]:
    """By the name of their file."""
    found = {(one.law, one.place): one for one in result.cells}
    places = list(dict.fromkeys(cell.place for cell in cells))
    laws, drawn = list(plan.laws), places[:MOST_PLACES]
    left_out = f" {len(drawn)} of {len(places)} places are drawn." if len(drawn) < len(places) else ""
    return {
        "settling": ComparisonFigure(
            _matrix(laws, drawn, found, result),
            "Settling of every law in every place",
            "Median time in seconds from which all vehicles stay within 10 cm of their slots, for 2 s at least; darker is "
            "later. A frame marks the soonest law of a row; a thick one is clear: the paired difference to the next is above "
            f"zero at 95 %.{left_out}",
        ),
        "by_graph": ComparisonFigure(
            _by_graph(laws, drawn, found, result.seconds),
            "Settling by graph, under each condition",
            "Median of the seeds with its interval of 95 %. In the grey strip: more than half of the flights did not settle.",
        ),
        "distance": ComparisonFigure(
            _distance(laws, drawn, found, result.seconds),
            "Smallest distance against settling",
            "One point for each graph: the nearer to the upper left, the better. The crosses are intervals of 95 %.",
        ),
    }


Found = dict[tuple[str, str], CellSummary]


def _interval(found: Found, law: str, place: Place, name: str) -> MedianInterval | None:
    one = found.get((law, place.name))
    return one.figures.get(name) if one else None


# ------------------------------------------------------------ laws by places


def _matrix(laws: Sequence[str], places: Sequence[Place], found: Found, result: Compared) -> Figure:
    labels = [_label(place) for place in places]
    size = (0.9 + 0.085 * max(map(len, labels)) + 1.25 * len(laws), 1.4 + 0.27 * len(places))
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots()
    best = {(one.place, one.law): one.clear for one in result.winners if one.figure == SETTLE}
    for row, place in enumerate(places):
        for column, law in enumerate(laws):
            settled = _interval(found, law, place, SETTLE)
            if settled is not None:
                _draw_cell(axes, (row, column), settled.median, result.seconds)
            clear = best.get((place.name, law))
            if clear is not None:
                frame = Rectangle(
                    (column - 0.46, row - 0.42),
                    0.92,
                    0.84,
                    fill=False,
                    edgecolor="black",
                    linewidth=2.2 if clear else 0.9,
                )
                axes.add_patch(frame)
        if row and place.graph != places[row - 1].graph:
            axes.axhline(row - 0.5, color="#404040", linewidth=0.8)
    axes.set_xlim(-0.5, len(laws) - 0.5)
    axes.set_ylim(len(places) - 0.5, -0.5)
    axes.set_xticks(range(len(laws)), [_folded(law) for law in laws], fontsize=9)
    axes.set_yticks(range(len(places)), labels, fontsize=9)
    axes.xaxis.tick_top()
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)
    return figure


def _draw_cell(axes: Axes, at: tuple[int, int], median_s: float | None, seconds: float) -> None:
    """A number on a shade: from white for half a second to grey for the duration of the flight; dark is never."""
    row, column = at
    late = 0.0 if median_s is None else log10(max(median_s, SOON_S) / SOON_S) / log10(seconds / SOON_S)
    shade = 0.42 if median_s is None else 1.0 - 0.35 * late
    axes.add_patch(Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, facecolor=(shade, shade, shade), linewidth=0))
    text = number_text(SETTLE, median_s)
    axes.text(column, row, text, ha="center", va="center", fontsize=9, color="black" if shade > 0.5 else "white")


def _label(place: Place) -> str:
    return ", ".join([f"{place.graph} {place.vehicles}", place.panel])


def _folded(law: str) -> str:
    return law.replace(" ", "\n").replace("_gain_1_s2", "").replace("_gain_1_s", "")


# ------------------------------------------------------------ panels by condition


def _panels(places: Sequence[Place]) -> dict[str, list[Place]]:
    """Places by condition and values of --vary."""
    found: dict[str, list[Place]] = {}
    for place in places:
        found.setdefault(place.panel, []).append(place)
    return dict(list(found.items())[:MOST_PANELS])


def _grid(panels: dict[str, list[Place]]) -> tuple[Figure, list[Axes]]:
    columns = 2 if len(panels) == 4 else min(3, len(panels))
    rows = -(-len(panels) // columns)
    size = (max(6.0, PANEL_IN[0] * columns), PANEL_IN[1] * rows + 0.9)
    figure = Figure(figsize=size, layout="constrained")
    every = list(figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel())
    for axes in every[len(panels) :]:
        axes.set_visible(False)
    for axes, name in zip(every, panels, strict=False):
        axes.set_title(name, fontsize=10)
        dress(axes, size=9)
        below = every.index(axes) + columns
        axes.tick_params(labelbottom=below >= len(panels))
    return figure, every[: len(panels)]


def _legend(figure: Figure, axes: Axes, laws: Sequence[str]) -> None:
    handles, labels = axes.get_legend_handles_labels()
    longest = max(map(len, laws))
    columns = max(1, min(len(laws), int(figure.get_figwidth() * 13 / (longest + 6))))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, fontsize=9, frameon=False)


def _look(index: int) -> dict[str, Any]:
    """Filled and open markers take turns, so that fourteen laws differ in grey."""
    colour = COLOURS[index % len(COLOURS)]
    filled = index // len(MARKERS) % 2 == 0
    return {
        "marker": MARKERS[index % len(MARKERS)],
        "color": colour,
        "markerfacecolor": colour if filled else "white",
        "markeredgecolor": colour,
        "markersize": 5,
        "linewidth": 1.0,
        "capsize": 0,
    }


def _by_graph(laws: Sequence[str], places: Sequence[Place], found: Found, seconds: float) -> Figure:
    panels = _panels(places)
    figure, every = _grid(panels)
    graphs = list(dict.fromkeys((place.graph, place.vehicles) for place in places))
    for axes, own in zip(every, panels.values(), strict=True):
        for index, law in enumerate(laws):
            shift = (index - (len(laws) - 1) / 2.0) * 0.8 / len(laws)
            points = [(graphs.index((p.graph, p.vehicles)) + shift, _interval(found, law, p, SETTLE)) for p in own]
            _errorbars(axes, [(x, one, None) for x, one in points if one], seconds, _look(index) | {"label": law})
        axes.set_xticks(range(len(graphs)), [f"{graph}\n{vehicles}" for graph, vehicles in graphs], fontsize=9)
        axes.set_xlim(-0.6, len(graphs) - 0.4)
        axes.set_yscale("log")
        _time_axis(axes, "y", seconds)
    figure.supylabel("settled to 10 cm after [s]", fontsize=10)
    _legend(figure, every[0], laws)
    return figure


def _distance(laws: Sequence[str], places: Sequence[Place], found: Found, seconds: float) -> Figure:
    panels = _panels(places)
    figure, every = _grid(panels)
    for axes, own in zip(every, panels.values(), strict=True):
        for index, law in enumerate(laws):
            pairs = [(_interval(found, law, p, DISTANCE), _interval(found, law, p, SETTLE)) for p in own]
            points = [(distance.median, settled, distance) for distance, settled in pairs if distance and settled]
            known = [(median, settled, distance) for median, settled, distance in points if median is not None]
            _errorbars(axes, known, seconds, _look(index) | {"label": law}, along="x")
        axes.set_xscale("log")
        _time_axis(axes, "x", seconds)
        axes.set_xlabel("settled to 10 cm after [s]" if axes.xaxis.get_tick_params()["labelbottom"] else "", fontsize=9)
    figure.supylabel("smallest distance of two vehicles [m]", fontsize=10)
    _legend(figure, every[0], laws)
    return figure


def _errorbars(
    axes: Axes,
    points: Sequence[tuple[float, MedianInterval, MedianInterval | None]],
    seconds: float,
    look: dict[str, Any],
    along: str = "y",
) -> None:
    """Points (other coordinate, settling, interval of the other coordinate), with settling along this axis."""
    never_s = seconds * NEVER_FACTOR
    other = np.array([point[0] for point in points])
    times = np.array([[_drawn_s(value, never_s) for value in (i.low, i.median, i.high)] for _, i, _ in points]).reshape(
        -1, 3
    )
    spans = np.array([[_or(i.low, x), _or(i.high, x)] for x, _, i in points if i is not None]).reshape(-1, 2)
    bars = np.abs(times[:, [0, 2]] - times[:, [1]]).T
    if along == "y":
        axes.errorbar(other, times[:, 1], yerr=bars, linestyle="none", **look)
    else:
        axes.errorbar(times[:, 1], other, xerr=bars, yerr=np.abs(spans - other[:, None]).T, linestyle="none", **look)


def _or(value: float | None, other: float) -> float:
    return other if value is None else value


def _drawn_s(value: float | None, never_s: float) -> float:
    return never_s if value is None else max(value, SOON_S)


def _time_axis(axes: Axes, along: str, seconds: float) -> None:
    """Plain numbers, and a grey strip for what never settled."""
    axis = axes.yaxis if along == "y" else axes.xaxis
    begin_s, end_s, never_s = SOON_S * 0.9, seconds * END_FACTOR, seconds * NEVER_FACTOR
    last_s = min(seconds, never_s * (begin_s / end_s) ** NEVER_ROOM)
    ticks_s = LogLocator(10.0, subs=(1.0, 2.0, 5.0)).tick_values(SOON_S, seconds)
    marks = [mark_s for mark_s in ticks_s if SOON_S <= mark_s <= last_s]
    axis.set_major_locator(FixedLocator([*marks, never_s]))
    axis.set_major_formatter(lambda value, _: "never" if value > seconds else f"{value:g}")
    axis.set_minor_locator(NullLocator())
    span = axes.axhspan if along == "y" else axes.axvspan
    span(seconds * 1.08, end_s, color="#e6e6e6", zorder=0, linewidth=0)
    limits = axes.set_ylim if along == "y" else axes.set_xlim
    limits(begin_s, end_s)
