"""How well the agents kept their 50 Hz: histograms with percentiles and limits, and lateness over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from companion.link.tick import LATE_S
from companion.report.arrays import Floats
from companion.report.figures.picture import DrawnFigure, picture
from companion.report.figures.style import (
    BOTTOM_IN,
    LEFT_IN,
    LEGEND_ROW_IN,
    LIMIT,
    RIGHT_IN,
    WIDTH_IN,
    TimeAxis,
    dress,
    dress_time,
    finish,
    look,
    new_figure,
    plot,
)
from companion.report.findings.timing import LATE_P99_MS, TO_COMMAND_P99_MS, in_air_ms, percentiles
from companion.report.flight import FlightRecords

LEAST_MS, MOST_MS, BINS = 0.01, 1000.0, 60
MOST_TICKS = 1e6  # more than five hours of one vehicle


def draw_histograms(flight: FlightRecords) -> DrawnFigure:
    """Of the ticks in the air."""
    figure = new_figure(3.0)
    left, right = figure.subplots(1, 2, sharey=True)
    for index, vehicle in enumerate(flight.vehicles):
        late_ms, to_command_ms = in_air_ms(vehicle)
        _histogram(left, late_ms, vehicle.vehicle_id, index)
        _histogram(right, to_command_ms, vehicle.vehicle_id, index)
    left.axvline(LATE_P99_MS, label=f"limit of p99: {LATE_P99_MS:g} ms", **LIMIT)
    right.axvline(TO_COMMAND_P99_MS, label=f"limit of p99: {TO_COMMAND_P99_MS:g} ms", **LIMIT)
    for axes, label in ((left, "lateness of the tick [ms]"), (right, "telemetry to command [ms]")):
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(label, fontsize=8.5)
        axes.set_xlim(LEAST_MS, MOST_MS)
        axes.set_ylim(0.7, MOST_TICKS)
        dress(axes, "ticks in the air [-]" if axes is left else "", 2)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=7, frameon=False, handlelength=3.0)
    rows = 1 + len(flight.vehicles)
    figure.set_figheight(2.4 + LEGEND_ROW_IN * rows)
    below = (BOTTOM_IN + LEGEND_ROW_IN * rows + 0.1) / figure.get_figheight()
    figure.subplots_adjust(
        left=LEFT_IN / WIDTH_IN, right=1.0 - RIGHT_IN / WIDTH_IN, top=0.97, bottom=below, wspace=0.12
    )
    caption = (
        "Both axes are logarithmic; ticks that were exactly on time count as 0.01 ms. Limits are those of the findings."
    )
    return picture(figure, "timing", "Timing of the ticks: histograms", caption)


def _histogram(axes: Axes, values_ms: Floats, vehicle_id: int, index: int) -> None:
    known = values_ms[~np.isnan(values_ms)]
    if not known.size:
        return
    edges = np.geomspace(LEAST_MS, MOST_MS, BINS)
    counts, _ = np.histogram(np.clip(known, LEAST_MS, MOST_MS), edges)
    found = percentiles(known)
    label = f"vehicle {vehicle_id}: p50 {found.p50_ms:.2f}, p99 {found.p99_ms:.2f}, max {found.max_ms:.1f} ms"
    axes.stairs(np.where(counts > 0, counts, np.nan), edges, label=label, **look(index))


def draw_lateness(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Lateness of every tick."""
    figure = new_figure(1.5)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        plot(axes, vehicle.timing.time_s, vehicle.timing.late_ms, f"vehicle {vehicle.vehicle_id}", **look(index))
    axes.axhline(1e3 * LATE_S, label=f"one period, {1e3 * LATE_S:g} ms", **LIMIT)
    axes.set_ylim(bottom=0.0)
    dress(axes, "lateness [ms]")
    dress_time([axes], axis)
    finish(figure, [axes])
    caption = "A tick that begins a period late is a missed tick."
    return picture(figure, "lateness", "Lateness of the ticks over time", caption)
