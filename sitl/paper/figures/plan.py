"""Figures 4, 9 and 10 of the report: positions and edges in plan view.

A leader is a red square, a follower a blue circle, so that they are distinct in greyscale.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from companion.config.fleet import LawName
from companion.stability.arrays import FloatArray
from companion.types.flight import Role
from sitl.paper.book import PERFECT, Book, Entry
from sitl.paper.claims.aggregation import has_gathered, left_for_good_s, range_m
from sitl.paper.figures.platoon import DPI, MODEL_TITLES
from sitl.paper.flights import FlightSubject, Model
from sitl.paper.measures import edges_m
from sitl.paper.topology import Topology, leaderships, reported_matrix, topology_at
from sitl.report.metrics import Pair, Tracks, reference_positions_m
from sitl.report.plots import GUIDE, LAW_TITLES, new_figure

RED, BLUE = "#C1272D", "#0072B2"
ROLE_LOOKS: Mapping[Role, dict[str, Any]] = {
    Role.LEADER: {"marker": "s", "color": RED, "markersize": 13},
    Role.FOLLOWER: {"marker": "o", "color": BLUE, "markersize": 13},
}
EDGE: dict[str, Any] = {"color": "#444444", "linewidth": 1.6, "zorder": 2}
TRAIL_S = 6.0
FIGURE_4_LAWS: tuple[LawName, ...] = ("average_26", "average_22", "weighted")


def save_figure_4(path: Path, book: Book) -> None:
    """Paths of the aggregation with starts, ends, goal and the edges at the end."""
    figure = new_figure(13.0, 12.0, "Aggregation of four vehicles with a range of 3 m: paths in plan view")
    grid = figure.subplots(len(PERFECT), len(FIGURE_4_LAWS), sharex=True, sharey=True)
    for row, model in zip(grid, PERFECT, strict=True):
        for axes, law in zip(row, FIGURE_4_LAWS, strict=True):
            _draw_aggregation(axes, book.one(FlightSubject.AGGREGATION, law, model))
        row[0].set_ylabel(f"{MODEL_TITLES[model]}\ny, north [m]")
    for axes, law in zip(grid[0], FIGURE_4_LAWS, strict=True):
        axes.set_title(f"{LAW_TITLES[law]}\n{axes.get_title()}", fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel("x, east [m]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=7, frameon=False, fontsize=10)
    figure.savefig(path, dpi=DPI)


def _draw_aggregation(axes: Axes, entry: Entry) -> None:
    flight, formation = entry.flight, entry.flight.formation
    goal = flight.reference(0.0).position_enu_m
    corners = {i: (goal[0] + slot[0], goal[1] + slot[1]) for i, slot in flight.slots_enu_m.items()}
    _draw_goal(axes, list(corners.values()))
    times_s = formation.times_s()
    for vehicle_id, track in flight.tracks.items():
        path_m = track.at(times_s)
        role = Role.LEADER if vehicle_id == 1 else Role.FOLLOWER
        colour = ROLE_LOOKS[role]["color"]
        axes.plot(
            path_m[:, 0],
            path_m[:, 1],
            color=colour,
            linewidth=1.3,
            linestyle="-" if role is Role.FOLLOWER else (0, (5, 1.5)),
            zorder=2.5,
            label=_once(axes, "path of the leader" if role is Role.LEADER else "path of a follower"),
        )
        start: dict[str, Any] = {"marker": "x", "color": "#000000", "markersize": 8, "linestyle": "", "zorder": 4}
        axes.plot(path_m[0, 0], path_m[0, 1], **start, label=_once(axes, "start"))
    _draw_edges(axes, flight.tracks, formation.end_s, edges_m(flight.tracks, formation.end_s, range_m(entry)))
    _draw_vehicles(
        axes, flight.tracks, formation.end_s, {i: Role.LEADER if i == 1 else Role.FOLLOWER for i in flight.tracks}
    )
    axes.set_title(_outcome_text(entry), fontsize=10, color="#333333")
    _dress_plan(axes)


def _outcome_text(entry: Entry) -> str:
    formation = entry.flight.formation
    left_s = left_for_good_s(entry)
    after = f"after {formation.end_s - formation.start_s:.0f} s"
    if left_s < float("inf"):
        return f"{after}: failed, leader alone from {left_s:.2f} s on"
    return f"{after}: {'gathered' if has_gathered(entry) else 'not gathered'}"


def _draw_goal(axes: Axes, corners: list[tuple[float, float]]) -> None:
    """Draw the goal square: every corner joined with its two nearest."""
    for corner in corners:
        for other in sorted(corners, key=lambda c: dist(c, corner))[1:3]:
            axes.plot([corner[0], other[0]], [corner[1], other[1]], **GUIDE, label=_once(axes, "goal"))


def _draw_edges(axes: Axes, tracks: Tracks, time_s: float, pairs: Iterable[Pair]) -> None:
    for i, j in pairs:
        (xi, yi, _), (xj, yj, _) = (_at(tracks, k, time_s) for k in (i, j))
        axes.plot([xi, xj], [yi, yj], **EDGE, label=_once(axes, "edge"))


def _draw_vehicles(axes: Axes, tracks: Tracks, time_s: float, roles: Mapping[int, Role]) -> None:
    for vehicle_id, role in sorted(roles.items()):
        x, y, _ = _at(tracks, vehicle_id, time_s)
        looks = ROLE_LOOKS[role]
        axes.plot(x, y, linestyle="", zorder=5, markeredgecolor="white", **looks, label=_once(axes, str(role)))
        axes.text(
            x, y, str(vehicle_id), color="white", fontsize=8, fontweight="bold", ha="center", va="center", zorder=6
        )


def _at(tracks: Tracks, vehicle_id: int, time_s: float) -> FloatArray:
    return np.asarray(tracks[vehicle_id].at(np.array([time_s]))[0])


def _once(axes: Axes, label: str) -> str:
    """The label, or none where the legend already has it."""
    return "_" if label in axes.get_legend_handles_labels()[1] else label


def _dress_plan(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="box")
    axes.grid(visible=True, color="#ececec", linewidth=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)


def save_figure_9(path: Path, book: Book) -> None:
    """One snapshot in the middle of every leadership, with the 8 and the last seconds of every path."""
    entry = book.one(FlightSubject.FIGURE_8, "weighted", Model.FULL)
    flight, spans = entry.flight, leaderships(entry.flown)
    columns = 3
    rows = -(-len(spans) // columns)
    figure = new_figure(13.0, 1.0 + 3.2 * rows, "Square on the figure of eight: snapshots in plan view")
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    lap_m = reference_positions_m(flight.reference, flight.formation.reference_start_s, flight.formation.times_s())
    for axes, lead in zip(grid.flat, spans, strict=False):
        time_s = (lead.from_s + lead.to_s) / 2
        axes.plot(lap_m[:, 0], lap_m[:, 1], **GUIDE, label="the 8, reference of the square's centre")
        for track in flight.tracks.values():
            trail_m = track.at(np.linspace(time_s - TRAIL_S, time_s, 100))
            axes.plot(
                trail_m[:, 0], trail_m[:, 1], color="#999999", linewidth=1.2, label=_once(axes, f"last {TRAIL_S:g} s")
            )
        topology = topology_at(entry.flown.topology, time_s)
        _draw_edges(axes, flight.tracks, time_s, _edges_of(topology))
        _draw_vehicles(axes, flight.tracks, time_s, {i: report.role for i, report in topology.items()})
        since_s = time_s - flight.formation.start_s
        axes.set_title(f"{since_s:.0f} s, leader: UAV {lead.leader_id}", fontsize=11)
        _dress_plan(axes)
    for axes in grid[-1]:
        axes.set_xlabel("x, east [m]")
    for row in grid:
        row[0].set_ylabel("y, north [m]")
    handles, labels = grid[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=5, frameon=False, fontsize=10)
    figure.savefig(path, dpi=DPI)


def _edges_of(topology: Topology) -> list[Pair]:
    """Pairs of which at least one reported the other as a neighbour."""
    return sorted({(min(i, j), max(i, j)) for i, report in topology.items() for j in report.neighbours})


def save_figure_10(path: Path, book: Book) -> None:
    """Roles, PrCs and weights just before a leader change, and after the last change of a PrC."""
    entry = book.one(FlightSubject.FIGURE_8, "weighted", Model.FULL)
    before, after = leaderships(entry.flown)[:2]
    figure = new_figure(11.5, 5.6, "Topology before and after a leader change, as reported by the vehicles")
    start_s = entry.flight.formation.start_s
    panels = [
        (after.from_s - 0.2, f"{after.from_s - 0.2 - start_s:.1f} s, leader: UAV {before.leader_id}"),
        (
            after.settled_s,
            f"{after.settled_s - start_s:.1f} s, leader: UAV {after.leader_id}, after the last change",
        ),
    ]
    for axes, (time_s, title) in zip(figure.subplots(1, 2, sharex=True, sharey=True), panels, strict=True):
        _draw_topology(axes, entry, time_s)
        axes.set_title(title, fontsize=11)
        axes.set_xlabel("x, east [m]")
    figure.axes[0].set_ylabel("y, north [m]")
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=10)
    figure.savefig(path, dpi=DPI)


def _draw_topology(axes: Axes, entry: Entry, time_s: float) -> None:
    """Draw the graph; the number at each end of an edge is the weight that this vehicle gives the other."""
    tracks, topology = entry.flight.tracks, topology_at(entry.flown.topology, time_s)
    ids = sorted(topology)
    matrix = reported_matrix(entry.flown, topology)
    _draw_edges(axes, tracks, time_s, _edges_of(topology))
    _draw_vehicles(axes, tracks, time_s, {i: report.role for i, report in topology.items()})
    centre = np.mean([_at(tracks, i, time_s) for i in ids], axis=0)
    for i in ids:
        own = _at(tracks, i, time_s)
        x, y, _ = own + 0.28 * (own - centre)
        axes.text(x, y, f"UAV {i}\nPrC {topology[i].prc}", ha="center", va="center", fontsize=9)
        for j in topology[i].neighbours:
            x, y, _ = own + 0.24 * (_at(tracks, j, time_s) - own)
            weight = -matrix[ids.index(i), ids.index(j)]
            box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"}
            axes.text(x, y, f"{weight:.2g}", ha="center", va="center", fontsize=9, bbox=box, zorder=4)
    axes.margins(0.25)
    _dress_plan(axes)
