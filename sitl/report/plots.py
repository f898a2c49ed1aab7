"""Figures 5 and 6 of Hou and Zhang (2021) from tracks: curves of x and y, and inter-distances.

Readable in grey: every vehicle and pair has its own line style and marker besides its colour.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray
from companion.report.plotting import (
    DPI,
    GUIDE,
    SOFT,
    dress,
    marked_look,
    marked_pair_look,
    put_legend_beside,
    titled_figure,
)
from sitl.report.metrics import (
    Formation,
    FormationFlight,
    Pair,
    TrackSource,
    distances_m,
    pair_name,
    reference_positions_m,
)

BEFORE_S = 2.0  # shown before the formation
PAIRS_SHOWN = 7  # each with a curve of its own; of more pairs the nearest and the farthest ones, the others thin
EXTREMES = 3  # as many of each
MIN_SPAN_M = 1.0  # smallest range of an axis

AT_END: dict[str, Any] = {
    "xycoords": ("axes fraction", "data"),
    "xytext": (4, 0),
    "textcoords": "offset points",
    "va": "center",
    "fontsize": 8,
    "annotation_clip": False,
}
TIME_LABEL = "time since the start of the formation [s]"
POSITIONS: dict[TrackSource, str] = {"true": "true positions", "estimated": "positions as estimated by the vehicles"}
LAW_TITLES = {
    "cooperative": "cooperative, not in the paper",
    "weighted": "weighted neighbours, eq. 14",
    "average_22": "average of neighbours, eq. 22",
    "average_26": "average of neighbours, eq. 26",
}


def save_figure_5(path: Path, flight: FormationFlight, name: str) -> None:
    """x and y of all vehicles over time, with their slots."""
    figure = titled_figure(8.4, 6.0, f"{name}: x and y of every vehicle")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=_heights([flight]))
    upper.set_title(f"{POSITIONS[flight.source]}, {law_title(flight)}", fontsize=10, color=SOFT)
    draw_positions(upper, flight, 0)
    draw_positions(lower, flight, 1)
    keep_a_span([upper])
    keep_a_span([lower])
    upper.set_ylabel("x, east [m]")
    lower.set_ylabel("y, north [m]")
    lower.set_xlabel(TIME_LABEL)
    put_legend_beside(upper)
    figure.savefig(path, dpi=DPI)


def save_figure_6(path: Path, flight: FormationFlight, name: str) -> None:
    """Inter-distances over time, with the wanted ones."""
    figure = titled_figure(8.4, 4.6 + _height_of_legends_in(len(flight.pairs)), f"{name}: inter-distances")
    axes = figure.subplots()
    axes.set_title(f"from {POSITIONS[flight.source]}, {law_title(flight)}", fontsize=10, color=SOFT)
    draw_distances(axes, flight)
    keep_a_span([axes], 0.5)
    axes.set_ylabel("distance [m]")
    axes.set_xlabel(TIME_LABEL)
    figure.savefig(path, dpi=DPI)


def save_comparison(path: Path, flights: Sequence[FormationFlight], name: str) -> None:
    """Figures 5 and 6 side by side, a column for each law."""
    height_in = 8.6 + _height_of_legends_in(max(len(flight.pairs) for flight in flights))
    title = f"{name}: the laws side by side, from {POSITIONS[flights[0].source]}"
    figure = titled_figure(1.4 + 4.4 * len(flights), height_in, title)
    heights = [*_heights(flights), 1.0]
    grid = figure.subplots(3, len(flights), sharex="col", sharey="row", squeeze=False, height_ratios=heights)
    for (x, y, distance), flight in zip(grid.T, flights, strict=True):
        x.set_title(law_title(flight), fontsize=11)
        draw_positions(x, flight, 0)
        draw_positions(y, flight, 1)
        draw_distances(distance, flight)
        distance.set_xlabel(TIME_LABEL)
    for row, label, span_m in zip(grid, ("x, east [m]", "y, north [m]", "distance [m]"), (1.0, 1.0, 0.5), strict=True):
        row[0].set_ylabel(label)
        keep_a_span(row, span_m)
    put_legend_beside(grid[0, -1])
    figure.savefig(path, dpi=DPI)


def law_title(flight: FormationFlight) -> str:
    """Title of the flight's column."""
    return LAW_TITLES.get(flight.law, flight.law)


def _times_s(flight: FormationFlight) -> FloatArray:
    """Sample times (n,), from a little before the formation to its end."""
    return Formation(flight.formation.start_s - BEFORE_S, flight.formation.end_s, 0.0).times_s()


def _heights(flights: Sequence[FormationFlight]) -> list[float]:
    """Relative heights of the panels of x and y: at least half the larger one."""
    extents = [np.ptp(track.position_enu_m, axis=0) for flight in flights for track in flight.tracks.values()]
    x_m, y_m, _ = np.max(extents, axis=0)
    widest_m = max(x_m, y_m, MIN_SPAN_M)
    return [max(0.5, float(extent_m / widest_m)) for extent_m in (x_m, y_m)]


def draw_positions(axes: Axes, flight: FormationFlight, axis: int) -> None:
    """One coordinate of every vehicle; thin dotted lines are the slots r + d_i0."""
    times_s = _times_s(flight)
    since_s = times_s - flight.formation.start_s
    reference_m = reference_positions_m(flight.reference, flight.formation.reference_start_s, times_s)[:, axis]
    for vehicle_id, track in sorted(flight.tracks.items()):
        axes.plot(since_s, reference_m + flight.slots[vehicle_id].at(times_s)[:, axis], **GUIDE, label="_")
        look = marked_look(vehicle_id - 1, times_s.size)
        axes.plot(since_s, track.at(times_s)[:, axis], label=f"vehicle {vehicle_id}", **look)
    axes.plot([], [], **GUIDE, label="its slot")
    dress_time(axes, since_s)


def draw_distances(axes: Axes, flight: FormationFlight) -> None:
    """The distance of every drawn pair, largest values in the legend; dotted lines are the wanted distances at the end.

    Where those of a few pairs differ, each has the name of its pair at its end, in the colour of the first vehicle.
    """
    times_s = _times_s(flight)
    since_s = times_s - flight.formation.start_s
    curves_m = {pair: distances_m(flight.tracks, pair, times_s) for pair in flight.pairs}
    wanted_m = {pair: round(float(distances_m(flight.slots, pair, times_s[-1:])[0]), 2) for pair in flight.pairs}
    several = len(flight.pairs) <= PAIRS_SHOWN and len(set(wanted_m.values())) > 1
    shown = _shown(curves_m, times_s >= flight.formation.start_s)
    others_m = [distance_m for pair, distance_m in curves_m.items() if pair not in shown]
    if others_m:
        axes.plot(since_s, np.transpose(others_m), color="#b0b0b0", linewidth=0.6, zorder=1.8)
        axes.plot([], [], color="#b0b0b0", linewidth=0.6, label=f"{len(others_m)} other pairs")
    for index, (pair, range_m) in enumerate(shown.items()):
        label, look = f"{pair_name(pair)}, {range_m}", marked_pair_look(pair, index, times_s.size)
        if several:
            label = f"{label}, wanted at the end {wanted_m[pair]:.2f} m"
            axes.axhline(wanted_m[pair], **GUIDE | {"color": look["color"], "linewidth": 1.6})
            axes.annotate(pair_name(pair), (1.0, wanted_m[pair]), **AT_END, color=look["color"])
        axes.plot(since_s, curves_m[pair], label=label, **look)
    if not flight.pairs:
        axes.text(0.5, 0.5, "one vehicle has no inter-distance", transform=axes.transAxes, ha="center")
    if flight.pairs and not several:
        values_m = sorted(set(wanted_m.values()))
        for value_m in values_m:
            axes.axhline(value_m, **GUIDE)
        axes.plot([], [], **GUIDE, label="wanted, " + " and ".join(f"{value_m:.2f} m" for value_m in values_m))
    if flight.pairs:
        _legend_of_distances(axes, len(flight.pairs))
    dress_time(axes, since_s)


def _legend_of_distances(axes: Axes, pairs: int) -> None:
    """Below the axes, where it covers no curve."""
    where: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.2), "ncols": 2, "frameon": False}
    axes.legend(**where, fontsize=7 if pairs > PAIRS_SHOWN else 8, handlelength=3.5, columnspacing=1.0)


def _height_of_legends_in(pairs: int) -> float:
    """Extra height of the figure for a legend below the axes."""
    return 0.8 if pairs > PAIRS_SHOWN else 0.25 + 0.1 * pairs


def _shown(curves_m: dict[Pair, FloatArray], inside: NDArray[np.bool_]) -> dict[Pair, str]:
    """The pairs with a curve of their own and what the legend says of each: its largest distance in formation.

    Of many pairs these are the EXTREMES that go farthest and as many that come nearest.
    """
    largest_m = {pair: float(curve[inside].max()) for pair, curve in curves_m.items()}
    if len(curves_m) <= PAIRS_SHOWN:
        return {pair: f"largest {value_m:.2f} m" for pair, value_m in largest_m.items()}
    smallest_m = {pair: float(curve[inside].min()) for pair, curve in curves_m.items()}
    farthest = sorted(curves_m, key=lambda pair: -largest_m[pair])[:EXTREMES]
    nearest = sorted(curves_m, key=lambda pair: smallest_m[pair])[:EXTREMES]
    return {pair: f"{smallest_m[pair]:.2f} to {largest_m[pair]:.2f} m" for pair in dict.fromkeys([*farthest, *nearest])}


def dress_time(axes: Axes, since_s: FloatArray, label: str = "") -> None:
    """Grid, frame and range of a time axis, with a line at zero."""
    axes.axvline(0.0, color="#bbbbbb", linewidth=0.8, zorder=1)
    axes.set_xlim(float(since_s[0]), float(since_s[-1]))
    dress(axes, y_label=label)


def keep_a_span(row: Sequence[Axes], span_m: float = MIN_SPAN_M) -> None:
    """Axes that share their scale show at least `span_m`."""
    lows, highs = np.array([axes.dataLim.intervaly for axes in row]).T
    low_m, high_m = float(lows.min()), float(highs.max())
    if not np.isfinite(high_m - low_m):  # nothing is drawn
        return
    margin_m = max(0.07 * (high_m - low_m), (span_m - (high_m - low_m)) / 2)
    for axes in row:
        axes.set_ylim(low_m - margin_m, high_m + margin_m)
