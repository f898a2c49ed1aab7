"""Figures 5 to 8 of the report: the platoon over time, one column per law."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from sitl.paper.book import PERFECT, Book, Entry
from sitl.paper.flights import COMPARED, FlightSubject, Model
from sitl.paper.measures import beginning
from sitl.report.metrics import Formation, FormationFlight, distances_m, pair_name
from sitl.report.plots import (
    GUIDE,
    LAW_TITLES,
    TIME_LABEL,
    draw_distances,
    draw_positions,
    keep_a_span,
    legend_beside,
    look,
    new_figure,
)

SHOWN_S = 45.0  # later only small oscillations remain
MODEL_TITLES = {
    Model.IDEAL: "ideal model",
    Model.FULL: "full quadrotor",
    Model.NOISY: "full quadrotor with sensor noise",
}
DPI = 130


def save_figure_5(path: Path, book: Book) -> None:
    """x and y of all vehicles, x with both models."""
    figure = new_figure(13.0, 8.6, "Platoon: x and y of every vehicle")
    grid = figure.subplots(3, len(COMPARED), sharex=True, sharey="row", height_ratios=[1.0, 1.0, 0.45])
    for column, law in zip(grid.T, COMPARED, strict=True):
        for axes, model in zip(column, PERFECT, strict=False):
            draw_positions(axes, _beginning(book.one(FlightSubject.PLATOON, law, model)), 0)
        draw_positions(column[2], _beginning(book.one(FlightSubject.PLATOON, law, Model.FULL)), 1)
        column[0].set_title(LAW_TITLES[law], fontsize=11)
        column[2].set_xlabel(TIME_LABEL)
    names = [f"x, {MODEL_TITLES[model]} [m]" for model in PERFECT]
    for row, name in zip(grid, [*names, "y, full [m]"], strict=True):
        row[0].set_ylabel(name)
        keep_a_span(row)
    legend_beside(grid[0, -1])
    figure.savefig(path, dpi=DPI)


def save_figure_6(path: Path, book: Book) -> None:
    """Inter-distances with both models."""
    figure = new_figure(13.0, 7.6, "Platoon: inter-distances")
    grid = figure.subplots(2, len(COMPARED), sharex=True, sharey=True)
    for column, law in zip(grid.T, COMPARED, strict=True):
        for axes, model in zip(column, PERFECT, strict=True):
            draw_distances(axes, _beginning(book.one(FlightSubject.PLATOON, law, model)))
        column[0].set_title(LAW_TITLES[law], fontsize=11)
        column[1].set_xlabel(TIME_LABEL)
    for row, model in zip(grid, PERFECT, strict=True):
        row[0].set_ylabel(f"distance, {MODEL_TITLES[model]} [m]")
    _span_of_all(grid.flat)
    figure.savefig(path, dpi=DPI)


def _beginning(entry: Entry) -> FormationFlight:
    return beginning(entry.flight, SHOWN_S)


def _span_of_all(axes: Sequence[Axes]) -> None:
    keep_a_span(list(axes), 0.5)


def save_figure_7(path: Path, book: Book) -> None:
    """x, y and altitude of whole flights with sensor noise, from take-off to landing."""
    figure = new_figure(12.0, 8.4, "Platoon with take-off and landing: x, y and altitude")
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=[1.0, 0.5, 0.5])
    for column, entry in zip(grid.T, _noisy(book), strict=True):
        times_s = _whole_s(entry.flight)
        for axis, axes in enumerate(column):
            for index, (vehicle_id, track) in enumerate(sorted(entry.flight.tracks.items())):
                axes.plot(times_s, track.at(times_s)[:, axis], label=f"UAV {vehicle_id}", **look(index, times_s.size))
            _shade(axes, entry.flight, times_s[-1])
        column[0].set_title(LAW_TITLES[entry.flight.law], fontsize=11)
        column[2].set_xlabel("time since the start of the flight [s]")
    for row, label in zip(grid, ("x, east [m]", "y, north [m]", "z, up [m]"), strict=True):
        row[0].set_ylabel(label)
        keep_a_span(row)
    for axes, entry in zip(grid[2], _noisy(book), strict=True):
        _name_the_parts(axes, entry.flight)
    legend_beside(grid[0, -1])
    figure.savefig(path, dpi=DPI)


def save_figure_8(path: Path, book: Book) -> None:
    """Inter-distances of the same flights."""
    figure = new_figure(12.0, 4.6, "Platoon with take-off and landing: inter-distances")
    row = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, entry in zip(row, _noisy(book), strict=True):
        flight, times_s = entry.flight, _whole_s(entry.flight)
        inside = (times_s >= flight.formation.start_s) & (times_s <= flight.formation.end_s)
        for index, pair in enumerate(flight.pairs):
            distance_m = distances_m(flight.tracks, pair, times_s)
            label = f"UAV {pair_name(pair)}, largest {distance_m[inside].max():.2f} m"
            axes.plot(times_s, distance_m, label=label, **look(index, times_s.size))
        desired_m = entry.figures.wanted_distance_m[pair_name(flight.pairs[0])]
        axes.axhline(desired_m, **GUIDE, label=f"desired, {desired_m:.2f} m")
        _shade(axes, flight, times_s[-1])
        axes.set_title(LAW_TITLES[flight.law], fontsize=11)
        axes.set_xlabel("time since the start of the flight [s]")
        axes.legend(loc="upper right", fontsize=8, framealpha=0.9, handlelength=3.5)
    row[0].set_ylabel("distance [m]")
    _span_of_all(row)
    figure.savefig(path, dpi=DPI)


def _noisy(book: Book) -> list[Entry]:
    return [book.one(FlightSubject.PLATOON, law, Model.NOISY) for law in ("average_22", "weighted")]


def _whole_s(flight: FormationFlight) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    end_s = max(float(track.time_s[-1]) for track in flight.tracks.values())
    return Formation(0.0, end_s, 0.0).times_s()


def _shade(axes: Axes, flight: FormationFlight, end_s: float) -> None:
    """Shade the time in formation."""
    axes.axvspan(flight.formation.start_s, flight.formation.end_s, color="#eef3f8", zorder=0)
    axes.set_xlim(0.0, end_s)
    axes.grid(visible=True, color="#e0e0e0", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def _name_the_parts(axes: Axes, flight: FormationFlight) -> None:
    middle_s = (flight.formation.start_s + flight.formation.end_s) / 2
    axes.text(middle_s, 0.12, "cooperation", ha="center", transform=axes.get_xaxis_transform(), color="#333333")
