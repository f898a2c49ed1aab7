"""The tracks from above, and who used whom."""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, pi, sin

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from companion.geometry.airspace import Cuboid, Cylinder, Obstacle
from companion.report.distances import PairDistance, in_formation
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.report.plotting import (
    LEFT_IN,
    MARKERS,
    RIGHT_IN,
    WIDTH_IN,
    DrawnFigure,
    dress,
    finish,
    look,
    new_figure,
    picture,
)

Range = tuple[float, float]
HIGHEST_IN = 5.2
POINTS = 1500  # of a drawn track
CORNERS = 24  # of a cylinder
MOST_CELLS = 16  # vehicles in the table of shares


def draw_tracks(flight: FlightRecords, pairs: Sequence[PairDistance]) -> DrawnFigure:
    """Tracks of all vehicles, with the place where two came nearest."""
    x_range, y_range = _view(flight)
    figure = new_figure(_height_in(x_range, y_range))
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        _draw_track(axes, vehicle, index)
    _nearest(axes, flight, pairs)
    _airspace(axes, flight, x_range, y_range)
    axes.set_xlim(*x_range)
    axes.set_ylim(*y_range)
    axes.set_aspect("equal")
    dress(axes, "north [m]")
    axes.set_xlabel("east [m]", fontsize=8.5)
    finish(figure, [axes])
    caption = (
        "Open symbols: first position; filled: last position. Fence and obstacles are drawn where they are in view."
    )
    return picture(figure, "tracks", "Tracks from above", caption)


def _view(flight: FlightRecords) -> tuple[Range, Range]:
    """What the tracks cover, with a margin: a far fence does not make them small."""
    tracks_m = [vehicle.ticks.position_enu_m[vehicle.ticks.located, :2] for vehicle in flight.vehicles]
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


def _draw_track(axes: Axes, vehicle: VehicleLog, index: int) -> None:
    position = vehicle.ticks.position_enu_m[vehicle.ticks.located]
    if not position.size:
        return
    begin = (float(position[0, 0]), float(position[0, 1]))
    drawn = position[:: max(1, len(position) // POINTS)]
    style = look(index)
    axes.plot(drawn[:, 0], drawn[:, 1], label=f"vehicle {vehicle.vehicle_id}", **style)
    marker = MARKERS[index % len(MARKERS)]
    axes.plot(*begin, marker, color=style["color"], markerfacecolor="white", markersize=7, zorder=4)
    axes.plot(*position[-1, :2], marker, color=style["color"], markersize=7, zorder=4)
    axes.annotate(str(vehicle.vehicle_id), begin, xytext=(5, 5), textcoords="offset points", fontsize=8, zorder=5)


def _nearest(axes: Axes, flight: FlightRecords, pairs: Sequence[PairDistance]) -> None:
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


def _airspace(axes: Axes, flight: FlightRecords, x_range: Range, y_range: Range) -> None:
    if flight.fleet is None:
        return
    fence = flight.fleet.airspace.fence
    (x0, y0, _), (x1, y1, _) = fence.min_enu_m, fence.max_enu_m
    corners = fence.corners_enu_m or ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    in_view = x_range[0] < x0 or x1 < x_range[1] or y_range[0] < y0 or y1 < y_range[1] or fence.corners_enu_m
    axes.add_patch(
        Polygon(
            corners,
            fill=False,
            edgecolor="#a3201d",
            linewidth=1.3,
            linestyle=(0, (6, 3)),
            label="fence" if in_view else "_",
            zorder=2,
        )
    )
    for number, obstacle in enumerate(flight.fleet.airspace.obstacles):
        axes.add_patch(
            Polygon(
                outline(obstacle),
                facecolor="#dddddd",
                edgecolor="#555555",
                hatch="///",
                linewidth=0.8,
                label="_" if number else "obstacle",
                zorder=1.5,
            )
        )


def outline(obstacle: Obstacle) -> list[tuple[float, float]]:
    """Corners of an obstacle from above."""
    if isinstance(obstacle, Cuboid):
        (x0, y0, _), (x1, y1, _) = obstacle.min_enu_m, obstacle.max_enu_m
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
    assert isinstance(obstacle, Cylinder)
    x, y = obstacle.centre_enu_m
    angles = [2.0 * pi * i / CORNERS for i in range(CORNERS)]
    return [(x + obstacle.radius_m * cos(angle), y + obstacle.radius_m * sin(angle)) for angle in angles]


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
    return picture(figure, "topology", "Topology: who used whom", caption)


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
    for row, own in enumerate(ids):
        for column, other in enumerate(ids):
            if own in places and other in places and share[row, column] > 0.005:
                axes.annotate(
                    "",
                    xy=places[own],
                    xytext=places[other],
                    arrowprops={
                        "arrowstyle": "-|>",
                        "linewidth": 0.4 + 1.8 * share[row, column],
                        "color": "#555555",
                        "shrinkA": 9,
                        "shrinkB": 9,
                        "connectionstyle": "arc3,rad=0.12",
                    },
                )
    for index, vehicle in enumerate(flight.vehicles):
        x, y = places[vehicle.vehicle_id]
        leads = bool(np.any(in_formation(vehicle) & (vehicle.ticks.role == "leader")))
        colour = look(index)["color"]
        axes.plot(
            x,
            y,
            "s" if leads else "o",
            markersize=15,
            markerfacecolor="white",
            color=colour,
            markeredgewidth=1.6,
            clip_on=False,
        )
        axes.text(x, y, str(vehicle.vehicle_id), ha="center", va="center", fontsize=8, fontweight="bold")
    axes.margins(0.2)
    dress(axes, "north of the reference [m]", 2)
    axes.set_xlabel("east of the reference [m]; square: leader", fontsize=8.5)
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
    for row in range(len(ids)):
        for column in range(len(ids)):
            value = share[row, column]
            if not np.isnan(value):
                text = "-" if value == 0.0 else f"{100.0 * value:.0f}" if value > 0.005 else "<1"
                axes.text(column, row, text, ha="center", va="center", fontsize=8 if len(ids) <= 8 else 6)
    axes.set_xticks(range(len(ids)), [str(i) for i in ids], fontsize=8)
    axes.set_yticks(range(len(ids)), [str(i) for i in ids], fontsize=8)
    axes.set_xlabel("used vehicle; share of the time [%]", fontsize=8.5)
    axes.set_ylabel("by vehicle", fontsize=8.5)
