"""The tracks from above, and who used whom."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from companion.config.fleet import FleetConfig
from companion.report.distances import PairDistance, in_formation
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.report.plotting import (
    GUIDE,
    LEFT_IN,
    MARKERS,
    RIGHT_IN,
    SIZE,
    SOFT,
    WIDTH_IN,
    DrawnFigure,
    draw_fence,
    draw_obstacles,
    dress_panel,
    finish,
    new_figure,
    render,
    vehicle_look,
)
from companion.types.flight import Role

Range = tuple[float, float]
HIGHEST_IN = 5.2
REFERENCE: dict[str, Any] = GUIDE | {"linewidth": 1.6, "zorder": 3}
POINTS = 1500  # largest number of points in a drawn track
MOST_CELLS = 16  # vehicles in the table of shares


def draw_tracks(flight: FlightRecords, pairs: Sequence[PairDistance]) -> DrawnFigure:
    """Tracks of all vehicles, with the place where two came nearest."""
    x_range, y_range = view(flight)
    figure = new_figure(_height_in(x_range, y_range))
    axes = figure.subplots()
    for vehicle in flight.vehicles:
        _draw_track(axes, vehicle)
    _draw_references(axes, flight)
    _draw_nearest(axes, flight, pairs)
    _draw_airspace(axes, flight.fleet, x_range, y_range)
    axes.set_xlim(*x_range)
    axes.set_ylim(*y_range)
    axes.set_aspect("equal")
    dress_panel(axes, "east [m]", "north [m]")
    finish(figure, [axes])
    caption = (
        "Open symbols: first position; filled: last position. Reference: of the leaders in formation; +: its end."
        " Fence and obstacles are drawn where they are in view."
    )
    return render(figure, "tracks", "Tracks from above", caption)


def view(flight: FlightRecords) -> tuple[Range, Range]:
    """What tracks and reference cover, with a margin: a far fence does not make them small."""
    tracks_m = [vehicle.ticks.position_enu_m[vehicle.ticks.located, :2] for vehicle in flight.vehicles]
    tracks_m += [reference_m[~np.isnan(reference_m[:, 0])] for reference_m in map(_reference_enu_m, flight.vehicles)]
    positions = [track_m for track_m in tracks_m if track_m.size]
    if not positions:
        return (-1.0, 1.0), (-1.0, 1.0)
    low, high = np.min([p.min(axis=0) for p in positions], axis=0), np.max([p.max(axis=0) for p in positions], axis=0)
    margin_m = max(1.0, 0.07 * float((high - low).max()))
    (x0, y0), (x1, y1) = (low - margin_m).tolist(), (high + margin_m).tolist()
    widen_m = max(0.0, (0.35 * (y1 - y0) - (x1 - x0)) / 2.0)  # a narrow flight to the north stays readable
    return (x0 - widen_m, x1 + widen_m), (y0, y1)


def _height_in(x_range: Range, y_range: Range) -> float:
    wanted_in = (WIDTH_IN - LEFT_IN - RIGHT_IN) * (y_range[1] - y_range[0]) / (x_range[1] - x_range[0])
    return float(np.clip(wanted_in, 1.6, HIGHEST_IN))


def _draw_track(axes: Axes, vehicle: VehicleLog) -> None:
    position = vehicle.ticks.position_enu_m[vehicle.ticks.located, :2]
    if not position.size:
        return
    drawn = position[:: max(1, len(position) // POINTS)]
    look = vehicle_look(vehicle.vehicle_id)
    axes.plot(*drawn.T, label=f"vehicle {vehicle.vehicle_id}", **look)
    marker = MARKERS[(vehicle.vehicle_id - 1) % len(MARKERS)]
    begin, end = position[[0, -1]].tolist()
    for place, fill in ((begin, "white"), (end, look["color"])):
        axes.plot(*place, marker, color=look["color"], markerfacecolor=fill, markersize=7, zorder=4)
    box = {"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.8}
    where: dict[str, Any] = {
        "xytext": (5, 5),
        "textcoords": "offset points",
        "fontsize": SIZE,
        "zorder": 5,
        "bbox": box,
    }
    axes.annotate(str(vehicle.vehicle_id), begin, **where)


def _reference_enu_m(vehicle: VehicleLog) -> Floats:
    """East and north (n, 2) of the reference that it led in formation; NaN at other times."""
    led = in_formation(vehicle) & (vehicle.ticks.role == Role.LEADER)
    return np.where(led[:, None], vehicle.ticks.reference_enu_m[:, :2], np.nan)


def _draw_references(axes: Axes, flight: FlightRecords) -> None:
    """What the formation followed: a dotted line, with a cross at its end. A reference at rest is the cross alone."""
    ends: list[tuple[float, Floats]] = []
    for vehicle in flight.vehicles:
        reference_m = _reference_enu_m(vehicle)
        known = np.flatnonzero(~np.isnan(reference_m[:, 0]))
        if known.size:
            axes.plot(*reference_m[:: max(1, len(reference_m) // POINTS)].T, label="_", **REFERENCE)
            ends.append((float(vehicle.ticks.time_s[known[-1]]), reference_m[known[-1]]))
    if ends:
        _, end_m = max(ends, key=lambda end: end[0])
        axes.plot(*end_m, "+", color=SOFT, markersize=10, markeredgewidth=1.8, zorder=5)
        axes.plot([], [], label="reference", marker="+", markeredgecolor=SOFT, **REFERENCE)


def _draw_nearest(axes: Axes, flight: FlightRecords, pairs: Sequence[PairDistance]) -> None:
    """A line between the two vehicles that came nearest, at that time."""
    if not pairs or not pairs[0].judged.any():
        return
    at_s = pairs[0].smallest_at_s
    ends = []
    for vehicle in flight.vehicles:
        if vehicle.vehicle_id in pairs[0].pair:
            ticks = vehicle.ticks
            ends.append([float(np.interp(at_s, ticks.time_s, column)) for column in ticks.position_enu_m.T[:2]])
    (x1, y1), (x2, y2) = ends
    label = f"nearest: {pairs[0].smallest_m:.2f} m at {at_s:.1f} s"
    axes.plot([x1, x2], [y1, y2], color="#000000", linewidth=2.6, solid_capstyle="round", label=label, zorder=6)


def _draw_airspace(axes: Axes, fleet: FleetConfig | None, x_range: Range, y_range: Range) -> None:
    """A fence that is a box alone is drawn where a side of it is in view."""
    if fleet is None:
        return
    fence = fleet.airspace.fence
    (x0, y0, _), (x1, y1, _) = fence.min_enu_m, fence.max_enu_m
    in_view = x_range[0] < x0 or x1 < x_range[1] or y_range[0] < y0 or y1 < y_range[1]
    box = ((x0, y0), (x1, y0), (x1, y1), (x0, y1)) if in_view else ()
    draw_fence(axes, fence.corners_enu_m or box)
    draw_obstacles(axes, fleet.airspace.obstacles)


def draw_topology(flight: FlightRecords) -> DrawnFigure | None:
    """Who used whom in formation, and for which share of the time; None without a formation."""
    shares = used_shares(flight)
    if shares is None:
        return None
    ids, share = shares
    figure = new_figure(2.4)
    graph, table = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
    _draw_graph(graph, flight, ids, share)
    _draw_table(table, ids, share)
    finish(figure, [])
    figure.subplots_adjust(wspace=0.22)
    caption = (
        "Left: an arrow from a neighbour to the vehicle that used it, wider the longer, at the mean slots. Right: share of"
        " the time in formation in which the vehicle of the row used that of the column."
    )
    return render(figure, "topology", "Topology: who used whom", caption)


def used_shares(flight: FlightRecords) -> tuple[list[int], Floats] | None:
    """(ids, share of the time in formation in which the vehicle of a row used that of a column)."""
    known = {other for vehicle in flight.vehicles for other in vehicle.ticks.neighbours}
    if not known:
        return None
    ids = sorted(known | set(flight.ids))[:MOST_CELLS]
    share = np.full((len(ids), len(ids)), np.nan)
    for vehicle in flight.vehicles:
        formation = in_formation(vehicle)
        if vehicle.vehicle_id not in ids or not formation.any():
            continue
        for column, other in enumerate(ids):
            use = vehicle.ticks.neighbours.get(other)
            row = ids.index(vehicle.vehicle_id)
            if row != column:
                share[row, column] = float(use.used[formation].mean()) if use else 0.0
    return ids, share


def _draw_graph(axes: Axes, flight: FlightRecords, ids: list[int], share: Floats) -> None:
    places = {vehicle.vehicle_id: _place(vehicle) for vehicle in flight.vehicles}
    arrow = {"arrowstyle": "-|>", "color": "#555555", "shrinkA": 9, "shrinkB": 9, "connectionstyle": "arc3,rad=0.12"}
    for row, column in zip(*np.nonzero(np.nan_to_num(share) > 0.005), strict=True):
        own, other = ids[row], ids[column]
        if own in places and other in places:
            props = arrow | {"linewidth": 0.4 + 1.8 * share[row, column]}
            axes.annotate("", xy=places[own], xytext=places[other], arrowprops=props)
    for vehicle in flight.vehicles:
        leads = bool(np.any(in_formation(vehicle) & (vehicle.ticks.role == Role.LEADER)))
        place, colour = places[vehicle.vehicle_id], vehicle_look(vehicle.vehicle_id)["color"]
        ring: dict[str, Any] = {"markersize": 15, "markerfacecolor": "white", "markeredgewidth": 1.6, "clip_on": False}
        axes.plot(*place, "s" if leads else "o", color=colour, **ring)
        axes.text(*place, str(vehicle.vehicle_id), ha="center", va="center", fontsize=SIZE, fontweight="bold")
    axes.margins(0.2)
    dress_panel(axes, "east of the reference [m]; square: leader", "north of the reference [m]", 2)
    axes.set_aspect("equal", adjustable="datalim")


def _place(vehicle: VehicleLog) -> tuple[float, float]:
    formation = in_formation(vehicle)
    offsets = vehicle.ticks.slot_offset_enu_m[formation if formation.any() else slice(None)]
    if not offsets.size:
        return (0.0, 0.0)
    x, y, _ = offsets.mean(axis=0)
    return (float(x), float(y))


def _draw_table(axes: Axes, ids: list[int], share: Floats) -> None:
    axes.imshow(share, cmap="Greys", vmin=0.0, vmax=1.6, aspect="auto")
    for (row, column), value in np.ndenumerate(share):
        if not np.isnan(value):
            text = "-" if value == 0.0 else f"{100.0 * value:.0f}" if value > 0.005 else "<1"
            axes.text(column, row, text, ha="center", va="center", fontsize=SIZE if len(ids) <= 8 else 6)
    names = [str(i) for i in ids]
    axes.set_xticks(range(len(ids)), names, fontsize=SIZE)
    axes.set_yticks(range(len(ids)), names, fontsize=SIZE)
    axes.set_xlabel("used vehicle; share of the time [%]", fontsize=SIZE + 0.5)
    axes.set_ylabel("by vehicle", fontsize=SIZE + 0.5)
