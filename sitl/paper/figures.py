"""The figures of the report: the paper's figures 4 to 10 flown again, and the latency of the followers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import dist, inf, nan
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from companion.analysis.interaction import FloatArray
from companion.config.law import LawName
from companion.report.plotting import (
    DPI,
    GUIDE,
    SOFT,
    dress_plan,
    label_once,
    marked_look,
    marked_pair_look,
    put_legend_below,
    put_legend_beside,
    titled_figure,
    vehicle_look,
)
from companion.types.flight import Role
from sitl.paper.aggregation_claims import has_gathered, left_for_good_s, range_m
from sitl.paper.flights import (
    COMPARED,
    PERFECT,
    Book,
    FlightSubject,
    FlownPlan,
    Model,
    Topology,
    beginning,
    behind_leader_m,
    edges_m,
    leaderships,
    reported_matrix,
    topology_at,
)
from sitl.report.metrics import Formation, FormationFlight, Pair, Tracks, distances_m, pair_name, reference_positions_m
from sitl.report.plots import LAW_TITLES, TIME_LABEL, draw_distances, draw_positions, dress_time, keep_a_span

SHOWN_S = 45.0  # later only small oscillations remain
MODEL_TITLES = {
    Model.IDEAL: "ideal model",
    Model.FULL: "full quadrotor",
    Model.NOISY: "full quadrotor with sensor noise",
}
EAST, NORTH = "x, east [m]", "y, north [m]"
WHOLE_LABEL = "time since the start of the flight [s]"
BOTH_LAWS: tuple[LawName, ...] = ("average_22", "weighted")
FIGURE_4_LAWS: tuple[LawName, ...] = ("average_26", "average_22", "weighted")
SHADES = {1: "#f4f4f4", 2: "#e2e8ee"}  # by leader
IN_FORMATION = "#eef3f8"
MARKERS_BY_ROLE = {Role.LEADER: "s", Role.FOLLOWER: "o"}  # the colour is that of the vehicle
EDGE: dict[str, Any] = {"color": SOFT, "linewidth": 1.6, "zorder": 2}
START: dict[str, Any] = {"marker": "x", "color": "#000000", "markersize": 8, "linestyle": "", "zorder": 4}
TRAIL_S = 6.0

Grid = NDArray[Any]
"""Axes, rows by columns."""


def _title_columns(grid: Grid, laws: Iterable[LawName], x_label: str) -> None:
    for column, law in zip(grid.T, laws, strict=True):
        column[0].set_title(LAW_TITLES[law], fontsize=11)
        column[-1].set_xlabel(x_label)


def _label_rows(grid: Grid, labels: Iterable[str], span_m: float | None = None) -> None:
    """`span_m`: the least range of the values of each row."""
    for row, label in zip(grid, labels, strict=True):
        row[0].set_ylabel(label)
        if span_m is not None:
            keep_a_span(row, span_m)


# ------------------------------------------------------------ the platoon over time


def save_figure_5(path: Path, book: Book) -> None:
    """x and y of all vehicles, x with both models."""
    figure = titled_figure(13.0, 8.6, "Platoon: x and y of every vehicle")
    grid = figure.subplots(3, len(COMPARED), sharex=True, sharey="row", height_ratios=[1.0, 1.0, 0.45])
    for column, law in zip(grid.T, COMPARED, strict=True):
        for axes, model, axis in zip(column, (*PERFECT, Model.FULL), (0, 0, 1), strict=True):
            draw_positions(axes, _beginning(book, law, model), axis)
    _title_columns(grid, COMPARED, TIME_LABEL)
    _label_rows(grid, [*(f"x, {MODEL_TITLES[model]} [m]" for model in PERFECT), "y, full [m]"], 1.0)
    put_legend_beside(grid[0, -1])
    figure.savefig(path, dpi=DPI)


def save_figure_6(path: Path, book: Book) -> None:
    """Inter-distances with both models."""
    figure = titled_figure(13.0, 7.6, "Platoon: inter-distances")
    grid = figure.subplots(2, len(COMPARED), sharex=True, sharey=True)
    for column, law in zip(grid.T, COMPARED, strict=True):
        for axes, model in zip(column, PERFECT, strict=True):
            draw_distances(axes, _beginning(book, law, model))
    _title_columns(grid, COMPARED, TIME_LABEL)
    _label_rows(grid, [f"distance, {MODEL_TITLES[model]} [m]" for model in PERFECT])
    keep_a_span(list(grid.flat), 0.5)
    figure.savefig(path, dpi=DPI)


def _beginning(book: Book, law: LawName, model: Model) -> FormationFlight:
    return beginning(book.one(FlightSubject.PLATOON, law, model).flight, SHOWN_S)


def save_figure_7(path: Path, book: Book) -> None:
    """x, y and altitude of whole flights with sensor noise, from take-off to landing."""
    figure = titled_figure(12.0, 8.4, "Platoon with take-off and landing: x, y and altitude")
    grid = figure.subplots(3, 2, sharex=True, sharey="row", height_ratios=[1.0, 0.5, 0.5])
    for column, entry in zip(grid.T, _noisy(book), strict=True):
        times_s = _whole_s(entry.flight)
        for axis, axes in enumerate(column):
            for vehicle_id, track in sorted(entry.flight.tracks.items()):
                look = marked_look(vehicle_id - 1, times_s.size)
                axes.plot(times_s, track.at(times_s)[:, axis], label=f"vehicle {vehicle_id}", **look)
            _shade(axes, entry.flight, times_s)
    _title_columns(grid, BOTH_LAWS, WHOLE_LABEL)
    _label_rows(grid, (EAST, NORTH, "z, up [m]"), 1.0)
    for axes, entry in zip(grid[2], _noisy(book), strict=True):
        formation = entry.flight.formation
        _name_a_time(axes, formation.start_s, formation.end_s, 0.12, "cooperation")
    put_legend_beside(grid[0, -1])
    figure.savefig(path, dpi=DPI)


def save_figure_8(path: Path, book: Book) -> None:
    """Inter-distances of the same flights."""
    figure = titled_figure(12.0, 4.6, "Platoon with take-off and landing: inter-distances")
    grid = figure.subplots(1, 2, sharex=True, sharey=True, squeeze=False)
    for axes, entry in zip(grid[0], _noisy(book), strict=True):
        flight, times_s = entry.flight, _whole_s(entry.flight)
        inside = (times_s >= flight.formation.start_s) & (times_s <= flight.formation.end_s)
        for index, pair in enumerate(flight.pairs):
            distance_m = distances_m(flight.tracks, pair, times_s)
            label = f"{pair_name(pair)}, largest {distance_m[inside].max():.2f} m"
            axes.plot(times_s, distance_m, label=label, **marked_pair_look(pair, index, times_s.size))
        desired_m = entry.figures.wanted_distance_m[pair_name(flight.pairs[0])]
        axes.axhline(desired_m, **GUIDE, label=f"desired, {desired_m:.2f} m")
        _shade(axes, flight, times_s)
        axes.legend(loc="upper right", fontsize=8, framealpha=0.9, handlelength=3.5)
    _title_columns(grid, BOTH_LAWS, WHOLE_LABEL)
    _label_rows(grid, ["distance [m]"], 0.5)
    figure.savefig(path, dpi=DPI)


def _noisy(book: Book) -> list[FlownPlan]:
    return [book.one(FlightSubject.PLATOON, law, Model.NOISY) for law in BOTH_LAWS]


def _whole_s(flight: FormationFlight) -> FloatArray:
    end_s = max(float(track.time_s[-1]) for track in flight.tracks.values())
    return Formation(0.0, end_s, 0.0).times_s()


def _shade(axes: Axes, flight: FormationFlight, times_s: FloatArray) -> None:
    """Shade the time in formation."""
    axes.axvspan(flight.formation.start_s, flight.formation.end_s, color=IN_FORMATION, zorder=0)
    dress_time(axes, times_s)


def _name_a_time(axes: Axes, from_s: float, to_s: float, height: float, text: str) -> None:
    """A text in the middle of this time, at a share of the panel's height."""
    where: dict[str, Any] = {"transform": axes.get_xaxis_transform(), "ha": "center", "va": "top"}
    axes.text((from_s + to_s) / 2, height, text, fontsize=9, color=SOFT, **where)


def save_latency(path: Path, book: Book) -> None:
    """One panel per law; the background shade shows the leader."""
    figure = titled_figure(12.0, 6.8, "Square on the figure of eight: distance to the slot relative to the leader")
    panels = list(figure.subplots(2, 1, sharex=True, sharey=True))
    for axes, law in zip(panels, BOTH_LAWS, strict=True):
        _draw_latency(axes, book.one(FlightSubject.FIGURE_8, law, Model.FULL))
        axes.set_title(f"{LAW_TITLES[law]}, full quadrotor", fontsize=11)
        axes.set_ylabel("distance [m]")
    panels[0].set_ylim(0.0, 1.12 * panels[0].get_ylim()[1])  # room for the labels of the leader
    panels[1].set_xlabel(TIME_LABEL)
    put_legend_below(figure, panels[0], 4)
    figure.savefig(path, dpi=DPI)


def _draw_latency(axes: Axes, entry: FlownPlan) -> None:
    """A leader has no distance to itself, so its curve has a gap during its leadership."""
    flight, start_s = entry.flight, entry.flight.formation.start_s
    times_s = flight.formation.times_s()
    spans = leaderships(entry)
    for vehicle_id in sorted(flight.tracks):
        distance_m = times_s * nan
        for lead in spans:
            during = (times_s >= lead.from_s) & (times_s <= lead.to_s)
            if vehicle_id != lead.leader_id:
                distance_m[during] = behind_leader_m(flight, lead.leader_id, vehicle_id, times_s[during])
        look = marked_look(vehicle_id - 1, 3 * times_s.size // 2)
        axes.plot(times_s - start_s, distance_m, label=f"vehicle {vehicle_id}", **look)
    dress_time(axes, times_s - start_s)
    for lead in spans:
        from_s, to_s = lead.from_s - start_s, lead.to_s - start_s
        axes.axvspan(from_s, to_s, color=SHADES.get(lead.leader_id, "#ffffff"), zorder=0)
        _name_a_time(axes, from_s, to_s, 0.95, f"leader: vehicle {lead.leader_id}")


# ------------------------------------------------------------ from above


def save_figure_4(path: Path, book: Book) -> None:
    """Paths of the aggregation with starts, ends, goal and the edges at the end."""
    figure = titled_figure(13.0, 12.0, "Aggregation of four vehicles with a range of 3 m: paths in plan view")
    grid = figure.subplots(len(PERFECT), len(FIGURE_4_LAWS), sharex=True, sharey=True)
    for row, model in zip(grid, PERFECT, strict=True):
        for axes, law in zip(row, FIGURE_4_LAWS, strict=True):
            entry = book.one(FlightSubject.AGGREGATION, law, model)
            _draw_aggregation(axes, entry)
            law_title = f"{LAW_TITLES[law]}\n" if model is PERFECT[0] else ""
            axes.set_title(law_title + _outcome_text(entry), fontsize=10.5)
        row[0].set_ylabel(f"{MODEL_TITLES[model]}\n{NORTH}")
    for axes in grid[-1]:
        axes.set_xlabel(EAST)
    put_legend_below(figure, grid[0, 0], 7)
    figure.savefig(path, dpi=DPI)


def _draw_aggregation(axes: Axes, entry: FlownPlan) -> None:
    flight, formation = entry.flight, entry.flight.formation
    _draw_goal(axes, flight)
    roles = {i: Role.LEADER if i == 1 else Role.FOLLOWER for i in flight.tracks}
    for vehicle_id, track in flight.tracks.items():
        path_m = track.at(formation.times_s())[:, :2]
        leads = roles[vehicle_id] is Role.LEADER
        name = "path of the leader" if leads else "path of a follower"
        look: dict[str, Any] = {
            "color": vehicle_look(vehicle_id)["color"],
            "linestyle": (0, (5, 1.5)) if leads else "-",
        }
        axes.plot(*path_m.T, linewidth=1.3, zorder=2.5, label=label_once(axes, name), **look)
        axes.plot(*path_m[0], **START, label=label_once(axes, "start"))
    _draw_edges(axes, flight.tracks, formation.end_s, edges_m(flight.tracks, formation.end_s, range_m(entry)))
    _draw_vehicles(axes, flight.tracks, formation.end_s, roles)
    dress_plan(axes)


def _outcome_text(entry: FlownPlan) -> str:
    formation = entry.flight.formation
    left_s = left_for_good_s(entry)
    after = f"after {formation.end_s - formation.start_s:.0f} s"
    if left_s < inf:
        return f"{after}: failed, leader alone from {left_s:.2f} s on"
    return f"{after}: {'gathered' if has_gathered(entry) else 'not gathered'}"


def _draw_goal(axes: Axes, flight: FormationFlight) -> None:
    """Draw the goal square: every corner joined with its two nearest."""
    x, y, _ = flight.reference(0.0).position_enu_m
    corners = [(x + slot[0], y + slot[1]) for slot in flight.slots_enu_m.values()]
    for corner in corners:
        for other in sorted(corners, key=lambda c: dist(c, corner))[1:3]:
            axes.plot(*zip(corner, other, strict=True), **GUIDE, label=label_once(axes, "goal"))


def _draw_edges(axes: Axes, tracks: Tracks, time_s: float, pairs: Iterable[Pair]) -> None:
    for pair in pairs:
        ends = [_at(tracks, i, time_s)[:2] for i in pair]
        axes.plot(*np.transpose(ends), **EDGE, label=label_once(axes, "edge"))


def _draw_vehicles(axes: Axes, tracks: Tracks, time_s: float, roles: Mapping[int, Role]) -> None:
    name: dict[str, Any] = {"color": "white", "fontsize": 8, "fontweight": "bold", "ha": "center", "va": "center"}
    for vehicle_id, role in sorted(roles.items()):
        x, y, _ = _at(tracks, vehicle_id, time_s)
        look: dict[str, Any] = {"color": vehicle_look(vehicle_id)["color"], "markersize": 13, "zorder": 5}
        axes.plot(x, y, MARKERS_BY_ROLE[role], markeredgecolor="white", label=label_once(axes, str(role)), **look)
        axes.text(x, y, str(vehicle_id), zorder=6, **name)


def _at(tracks: Tracks, vehicle_id: int, time_s: float) -> FloatArray:
    return np.asarray(tracks[vehicle_id].at(np.array([time_s]))[0])


def save_figure_9(path: Path, book: Book) -> None:
    """One snapshot in the middle of every leadership, with the 8 and the last seconds of every path."""
    entry = book.one(FlightSubject.FIGURE_8, "weighted", Model.FULL)
    flight, spans = entry.flight, leaderships(entry)
    rows = -(-len(spans) // 3)
    figure = titled_figure(13.0, 1.0 + 3.2 * rows, "Square on the figure of eight: snapshots in plan view")
    grid = figure.subplots(rows, 3, sharex=True, sharey=True, squeeze=False)
    lap_m = reference_positions_m(flight.reference, flight.formation.reference_start_s, flight.formation.times_s())
    for axes, lead in zip(grid.flat, spans, strict=False):
        time_s = (lead.from_s + lead.to_s) / 2
        axes.plot(*lap_m[:, :2].T, **GUIDE, label="the 8, reference of the square's centre")
        for track in flight.tracks.values():
            trail_m = track.at(np.linspace(time_s - TRAIL_S, time_s, 100))[:, :2]
            axes.plot(*trail_m.T, color="#999999", linewidth=1.2, label=label_once(axes, f"last {TRAIL_S:g} s"))
        _draw_reported(axes, flight.tracks, topology_at(entry.topology, time_s), time_s)
        since_s = time_s - flight.formation.start_s
        axes.set_title(f"{since_s:.0f} s, leader: vehicle {lead.leader_id}", fontsize=11)
    for axes in grid[-1]:
        axes.set_xlabel(EAST)
    _label_rows(grid, [NORTH] * rows)
    put_legend_below(figure, grid[0, 0], 5)
    figure.savefig(path, dpi=DPI)


def _draw_reported(axes: Axes, tracks: Tracks, topology: Topology, time_s: float) -> None:
    """Vehicles with their roles; an edge where at least one of two reported the other as a neighbour."""
    pairs = {(min(i, j), max(i, j)) for i, report in topology.items() for j in report.neighbours}
    _draw_edges(axes, tracks, time_s, sorted(pairs))
    _draw_vehicles(axes, tracks, time_s, {i: report.role for i, report in topology.items()})
    dress_plan(axes)


def save_figure_10(path: Path, book: Book) -> None:
    """Roles, PrCs and weights just before a leader change, and after the last change of a PrC."""
    entry = book.one(FlightSubject.FIGURE_8, "weighted", Model.FULL)
    before, after = leaderships(entry)[:2]
    figure = titled_figure(11.5, 5.6, "Topology before and after a leader change, as reported by the vehicles")
    panels = (
        (after.from_s - 0.2, f"leader: vehicle {before.leader_id}"),
        (after.settled_s, f"leader: vehicle {after.leader_id}, after the last change"),
    )
    row: Sequence[Axes] = figure.subplots(1, 2, sharex=True, sharey=True)
    for axes, (time_s, title) in zip(row, panels, strict=True):
        _draw_weights(axes, entry, time_s)
        axes.set_title(f"{time_s - entry.flight.formation.start_s:.1f} s, {title}", fontsize=11)
        axes.set_xlabel(EAST)
    row[0].set_ylabel(NORTH)
    put_legend_below(figure, row[0], 4)
    figure.savefig(path, dpi=DPI)


def _draw_weights(axes: Axes, entry: FlownPlan, time_s: float) -> None:
    """Draw the graph; the number at each end of an edge is the weight that this vehicle gives the other."""
    tracks, topology = entry.flight.tracks, topology_at(entry.topology, time_s)
    ids = sorted(topology)
    matrix = reported_matrix(entry, topology)
    _draw_reported(axes, tracks, topology, time_s)
    middle: dict[str, Any] = {"ha": "center", "va": "center", "fontsize": 9}
    box = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"}
    centre = np.mean([_at(tracks, i, time_s) for i in ids], axis=0)
    for i in ids:
        own = _at(tracks, i, time_s)
        x, y, _ = own + 0.28 * (own - centre)
        axes.text(x, y, f"vehicle {i}\nPrC {topology[i].prc}", **middle)
        for j in topology[i].neighbours:
            x, y, _ = own + 0.24 * (_at(tracks, j, time_s) - own)
            weight = -matrix[ids.index(i), ids.index(j)]
            axes.text(x, y, f"{weight:.2g}", bbox=box, zorder=4, **middle)
    axes.margins(0.25)


SAVED: Mapping[str, Callable[[Path, Book], None]] = {
    "figure_4.png": save_figure_4,
    "figure_5.png": save_figure_5,
    "figure_6.png": save_figure_6,
    "figure_7.png": save_figure_7,
    "figure_8.png": save_figure_8,
    "figure_9.png": save_figure_9,
    "figure_10.png": save_figure_10,
    "latency.png": save_latency,
}
"""What saves each figure; its heading and its claims are in `words.toml`."""
