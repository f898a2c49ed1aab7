"""Figures 9 and 10 of Hou and Zhang (2021) from tracks: the formation from above, one panel per command that changed it.

Readable in grey: leaders are filled squares, followers open circles, vehicles not in formation crosses,
obstacles hatched.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patheffects import withStroke

from companion.analysis.interaction import FloatArray
from companion.geometry.airspace import Airspace
from companion.report.plotting import (
    DPI,
    GUIDE,
    SOFT,
    draw_fence,
    draw_obstacles,
    dress_plan,
    put_legend_below,
    titled_figure,
    vehicle_look,
)
from companion.types.flight import Role
from sitl.report.metrics import Formation, FormationFlight, reference_positions_m
from sitl.report.plots import POSITIONS, law_title
from sitl.report.summary import CommandGiven, TopologyChange

COLUMNS = 3
MAX_PANELS = 9
SOON_S = 2.0
PANEL_IN = 4.0
SAMPLE_S = 0.1
SHAPES = (0.35, 1.2)  # height to width of a panel, at the least and at the most
MARGIN = 0.06  # of the larger extent
EDGE = "#999999"
# By the role; the colour is that of the vehicle.
LEADS: dict[str, Any] = {"marker": "s", "markersize": 8, "linestyle": ""}
FOLLOWS: dict[str, Any] = LEADS | {"marker": "o", "markerfacecolor": "white", "markeredgewidth": 1.5}
ELSEWHERE: dict[str, Any] = LEADS | {"marker": "x", "markeredgewidth": 1.5}
BESIDE: dict[str, Any] = {
    "xytext": (6, 6),
    "textcoords": "offset points",
    "fontsize": 8,
    "fontweight": "bold",
    "zorder": 5,
    "path_effects": [withStroke(linewidth=3, foreground="white")],  # read on lines, too
}


class FlightRecord(Protocol):
    """What the figure draws beside the tracks. Times of commands and topology count from `began_s`, of the tracks' clock."""

    began_s: float
    formations: list[Formation]
    commands: list[CommandGiven]
    topology: list[TopologyChange]


@dataclass(frozen=True, slots=True)
class PlanPanel:
    """A part of a formation, in seconds of the tracks' clock, and the command at its start."""

    start_s: float
    end_s: float
    command: str


def save_plan_view(path: Path, flight: FormationFlight, watch: FlightRecord, name: str, airspace: Airspace) -> None:
    """Paths from above; at each panel's end the positions, leaders and neighbours. Polygon of the fence, and obstacles."""
    panels = panels_of(watch)
    columns = min(COLUMNS, len(panels))
    rows = ceil(len(panels) / columns)
    low_m, high_m = _extent_m(flight, panels, airspace)
    width_m, height_m = high_m - low_m
    panel_in = PANEL_IN * float(np.clip(height_m / width_m, *SHAPES))
    width_in, legend_columns = 0.8 + PANEL_IN * max(columns, 1.8), 6 if columns == COLUMNS else 3
    figure = titled_figure(
        width_in, 1.4 + (panel_in + 0.35) * rows + 0.2 * (6 // legend_columns - 1), f"{name}: from above"
    )
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    for axes, panel in zip(grid.flat, panels, strict=False):
        draw_fence(axes, airspace.fence.corners_enu_m)
        draw_obstacles(axes, airspace.obstacles)
        _draw(axes, flight, watch, panel)
        axes.set_xlim(low_m[0], high_m[0])
        axes.set_ylim(low_m[1], high_m[1])
    for axes in grid.flat[len(panels) :]:
        axes.set_visible(False)
    for axes in grid.flat[max(0, len(panels) - columns) : len(panels)]:
        axes.tick_params(labelbottom=True)
        axes.set_xlabel("x, east [m]")
    for axes in grid[:, 0]:
        axes.set_ylabel("y, north [m]")
    _legend(grid[0, 0])
    put_legend_below(figure, grid[0, 0], legend_columns, f"{POSITIONS[flight.source]}, {law_title(flight)}")
    figure.savefig(path, dpi=DPI)


def panels_of(watch: FlightRecord) -> list[PlanPanel]:
    """Panels from the first formation's start to the last one's end, divided by commands; at most the last MAX_PANELS.

    Commands within SOON_S share a panel, and a repeated command counts once. One so soon before the end, as the first of those
    that land the fleet, has no panel: nothing follows it.
    """
    start_s, end_s = watch.formations[0].start_s, watch.formations[-1].end_s
    panels = [PlanPanel(start_s, end_s, "form")]
    for given in watch.commands:
        at_s, last = watch.began_s + given.time_s, panels[-1]
        if not start_s < at_s < end_s - SOON_S or last.command.endswith(given.in_words):
            continue
        if at_s - last.start_s < SOON_S:
            panels[-1] = PlanPanel(last.start_s, end_s, f"{last.command}, {given.in_words}")
        else:
            panels[-1:] = [PlanPanel(last.start_s, at_s, last.command), PlanPanel(at_s, end_s, given.in_words)]
    return panels[-MAX_PANELS:]


def _extent_m(
    flight: FormationFlight, panels: Sequence[PlanPanel], airspace: Airspace
) -> tuple[FloatArray, FloatArray]:
    """Lower left and upper right corner, (2,) each, of everything drawn, with a margin."""
    times_s = np.arange(panels[0].start_s, panels[-1].end_s, SAMPLE_S)
    flown_m = np.concatenate([track.at(times_s)[:, :2] for track in flight.tracks.values()])
    if airspace.fence.corners_enu_m:
        flown_m = np.concatenate([flown_m, np.array(airspace.fence.corners_enu_m)])
    low_m, high_m = flown_m.min(axis=0), flown_m.max(axis=0)
    largest_m = float(max(*(high_m - low_m), 1.0))
    middle_m, half_m = (low_m + high_m) / 2.0, np.maximum((high_m - low_m) / 2.0, SHAPES[0] * largest_m / 2.0)
    return middle_m - half_m - MARGIN * largest_m, middle_m + half_m + MARGIN * largest_m


def _draw(axes: Axes, flight: FormationFlight, watch: FlightRecord, panel: PlanPanel) -> None:
    times_s = np.linspace(panel.start_s, panel.end_s, max(2, round((panel.end_s - panel.start_s) / SAMPLE_S)))
    reference_m = reference_positions_m(flight.reference, flight.formation.reference_start_s, times_s)
    axes.plot(*reference_m[:, :2].T, **GUIDE)
    now = {change.vehicle: change for change in watch.topology if watch.began_s + change.time_s <= panel.end_s}
    at_end = {i: track.at(times_s[-1:])[0] for i, track in flight.tracks.items()}
    _draw_edges(axes, at_end, list(now.values()))
    for vehicle_id, track in sorted(flight.tracks.items()):
        colour = vehicle_look(vehicle_id)["color"]
        axes.plot(*track.at(times_s)[:, :2].T, color=colour, linewidth=0.9, alpha=0.7)
        x_m, y_m, _ = at_end[vehicle_id]
        axes.plot([x_m], [y_m], color=colour, **_look(now.get(vehicle_id)))
        axes.annotate(str(vehicle_id), (x_m, y_m), **BESIDE, color=colour)
    since_s = watch.formations[0].start_s
    axes.set_title(
        f"{panel.start_s - since_s:.0f} to {panel.end_s - since_s:.0f} s, after {panel.command}", fontsize=10
    )
    dress_plan(axes)


def _draw_edges(axes: Axes, at_end: dict[int, FloatArray], topology: Sequence[TopologyChange]) -> None:
    in_formation = {c.vehicle for c in topology if c.in_formation}
    edges = ((c.vehicle, j) for c in topology for j in c.neighbours if {c.vehicle, j} <= in_formation)
    pairs = {(min(pair), max(pair)) for pair in edges}
    for i, j in sorted(pairs):
        (xi, yi, _), (xj, yj, _) = at_end[i], at_end[j]
        axes.plot([xi, xj], [yi, yj], color=EDGE, linewidth=1.0, zorder=1.8)


def _look(part: TopologyChange | None) -> dict[str, Any]:
    if part is None or not part.in_formation:
        return ELSEWHERE
    return LEADS if part.role is Role.LEADER else FOLLOWS


def _legend(axes: Axes) -> None:
    """Legend entries for what `_draw` draws."""
    for look, name in ((LEADS, "leader"), (FOLLOWS, "follower"), (ELSEWHERE, "not in formation")):
        axes.plot([], [], color=SOFT, **look, label=name)
    axes.plot([], [], color=SOFT, linewidth=0.9, label="path")
    axes.plot([], [], color=EDGE, linewidth=1.0, label="neighbours")
    axes.plot([], [], **GUIDE, label="reference")
