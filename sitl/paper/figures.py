"""Figures 5 to 8 of the report: the platoon over time, one column per law."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from math import dist
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from companion.analysis.interaction import FloatArray
from companion.config.fleet import LawName
from companion.types.flight import Role
from sitl.paper.aggregation_claims import has_gathered, left_for_good_s, range_m
from sitl.paper.flights import (
    COMPARED,
    PERFECT,
    Book,
    Entry,
    FlightSubject,
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
from sitl.report.plots import (
    GUIDE,
    LAW_TITLES,
    TIME_LABEL,
    draw_distances,
    draw_positions,
    dress,
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


LAWS: tuple[LawName, ...] = ("average_22", "weighted")
SHADES = {1: "#f4f4f4", 2: "#e2e8ee"}  # by leader


def save_latency(path: Path, book: Book) -> None:
    """One panel per law; the background shade shows the leader."""
    figure = new_figure(12.0, 6.8, "Square on the figure of eight: distance to the slot relative to the leader")
    for axes, law in zip(figure.subplots(2, 1, sharex=True, sharey=True), LAWS, strict=True):
        _draw(axes, book.one(FlightSubject.FIGURE_8, law, Model.FULL))
        axes.set_title(f"{LAW_TITLES[law]}, full quadrotor", fontsize=11)
        axes.set_ylabel("distance [m]")
    figure.axes[0].set_ylim(0.0, 1.12 * figure.axes[0].get_ylim()[1])  # room for the labels of the leader
    figure.axes[1].set_xlabel(TIME_LABEL)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=10, handlelength=3.5)
    figure.savefig(path, dpi=DPI)


def _draw(axes: Axes, entry: Entry) -> None:
    """A leader has no distance to itself, so its curve has a gap during its leadership."""
    flight, formation = entry.flight, entry.flight.formation
    times_s = formation.times_s()
    since_s = times_s - formation.start_s
    spans = leaderships(entry.flown)
    for index, vehicle_id in enumerate(sorted(flight.tracks)):
        distance_m = times_s * float("nan")
        for lead in spans:
            during = (times_s >= lead.from_s) & (times_s <= lead.to_s)
            if vehicle_id != lead.leader_id:
                distance_m[during] = behind_leader_m(flight, lead.leader_id, vehicle_id, times_s[during])
        axes.plot(since_s, distance_m, label=f"UAV {vehicle_id}", **look(index, 3 * times_s.size // 2))
    dress(axes, since_s)
    for lead in spans:
        from_s, to_s = lead.from_s - formation.start_s, lead.to_s - formation.start_s
        axes.axvspan(from_s, to_s, color=SHADES.get(lead.leader_id, "#ffffff"), zorder=0)
        axes.text((from_s + to_s) / 2, 0.95, f"leader: UAV {lead.leader_id}", transform=axes.get_xaxis_transform(),
                  ha="center", va="top", fontsize=9, color="#333333")  # fmt: skip


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


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure of the report. The claims of `claim_ids` are shown below it."""

    file: str
    heading: str
    shows: str
    claim_ids: tuple[str, ...]
    save: Callable[[Path, Book], None]


PICTURES = (
    PaperFigure(
        "figure_4.png",
        "Figure 4: aggregation",
        "Paths in plan view, of the ideal model (upper row) and the full quadrotor (lower row). Left: the average law that the "
        "paper names for its comparison. Middle: the average law of its proofs. Right: the weighted law. Edges join vehicles "
        "in range of each other at the end.",
        ("fig-4-average", "fig-4-weighted", "fig-4-robust", "average-law"),
        save_figure_4,
    ),
    PaperFigure(
        "figure_5.png",
        "Figure 5: x and y of the platoon",
        "True positions. The left panel of the paper's figure is one of the two average laws, the right one the weighted law.",
        ("fig-5-faster", "latency-hops"),
        save_figure_5,
    ),
    PaperFigure(
        "figure_6.png",
        "Figure 6: inter-distances of the platoon",
        "All panels have the same scale. The claims below show which average law fits the left panel of the paper's figure, "
        "with its peak of 1.8 m.",
        ("fig-6-average", "fig-6-weighted-d12", "fig-6-weighted-d23-d34", "fig-6-one-peak", "fig-6-faster"),
        save_figure_6,
    ),
    PaperFigure(
        "figure_7.png",
        "Figure 7: the platoon with take-off and landing",
        "A whole flight of the full quadrotor with sensor noise, in place of the paper's experiment. In the shaded time the "
        "vehicles are in formation; before and after it each flies in a mode of its autopilot.",
        ("fig-7-response",),
        save_figure_7,
    ),
    PaperFigure(
        "figure_8.png",
        "Figure 8: inter-distances with take-off and landing",
        "The same flights. The largest distances are of the time in formation.",
        ("fig-8-peak",),
        save_figure_8,
    ),
    PaperFigure(
        "figure_9.png",
        "Figure 9: a square on the figure of eight",
        "One snapshot in the middle of every leadership, full quadrotor. The centre of the square follows the 8.",
        ("fig-9",),
        save_figure_9,
    ),
    PaperFigure(
        "figure_10.png",
        "Figure 10: topology and weights",
        "Before the first leader change, and after the last report that it changed. The number near a vehicle on an edge is "
        "the weight that this vehicle gives the other one, computed from the reported PrCs.",
        ("fig-10-matrices", "fig-10-at-once", "section-5.2"),
        save_figure_10,
    ),
    PaperFigure(
        "latency.png",
        "Section 5.2: latency of the followers",
        "The vehicle opposite to the leader is two hops away: UAV 3 with UAV 1 as the leader, UAV 4 with UAV 2.",
        ("latency-diagonal", "latency-reduced"),
        save_latency,
    ),
)
