"""Figures of states as bars over time (phases, leader, flags), and of timing as histograms."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from companion.report.findings import Interval, runs, stretches
from companion.report.flight import Anything, FlightRecords, Floats, VehicleLog
from companion.report.flight_findings import counts_of
from companion.report.plotting import (
    BOTTOM_IN,
    LEFT_IN,
    LEGEND_ROW_IN,
    LIMIT,
    RIGHT_IN,
    SIZE,
    WIDTH_IN,
    DrawnFigure,
    TimeAxis,
    dress_panel,
    dress_time,
    finish,
    new_figure,
    pale,
    render,
    vehicle_look,
)
from companion.report.record_findings import LATE_P99_MS, TO_COMMAND_P99_MS, in_air_ms, percentiles
from companion.types.flight import FlightPhase

LETTER_ROOM = 0.012  # width of a letter, as a share of the time shown
EDGE: dict[str, Any] = {"edgecolor": "#555555", "linewidth": 0.5}
GAP_S = 0.5  # a longer gap of the recording is no part of a bar
# From light to dark with what is at stake; hatches tell apart what follows each other.
PHASES: dict[str, tuple[str, str]] = {
    FlightPhase.OBSERVE: ("#ffffff", ""),
    FlightPhase.PREPARE: ("#f0f0f0", ""),
    FlightPhase.READY: ("#f0f0f0", ".."),
    FlightPhase.ARM: ("#e3e3e3", ""),
    FlightPhase.ARMED: ("#e3e3e3", ".."),
    FlightPhase.TAKEOFF: ("#cfe3f1", "//"),
    FlightPhase.HOLD: ("#f6e3b4", ""),
    FlightPhase.ENGAGE: ("#9cc9a9", "//"),
    FlightPhase.FORMATION: ("#9cc9a9", ""),
    FlightPhase.RELEASE: ("#f6e3b4", "//"),
    FlightPhase.LAND: ("#cfe3f1", "\\\\"),
    FlightPhase.RETURN: ("#e7bcae", "\\\\"),
}


LEAST_MS, MOST_MS, BINS = 0.01, 1000.0, 60
MOST_TICKS = 1e6  # more than five hours of one vehicle
FLAG_COUNTS, FLAG_EXPECTED = "#8c3b2a", "#d4d4d4"


@dataclass(frozen=True, slots=True)
class Bar:
    interval: Interval
    colour: str
    hatch: str = ""
    label: str = ""


BarRow = tuple[str, list[Bar]]
"""Label and bars of one row."""


def draw_phases(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Phase of every agent."""

    def bar(_vehicle: VehicleLog, interval: Interval, phase: Any) -> Bar:
        colour, hatch = PHASES.get(str(phase), ("#ffffff", "xx"))
        return Bar(interval, colour, hatch, str(phase))

    rows = [_states(vehicle, vehicle.ticks.phase, bar) for vehicle in flight.vehicles]
    caption = "Phase of each agent. A gap: nothing is recorded."
    return _draw(rows, axis, "phases", "Flight phases over time", caption, used_phases(flight))


def used_phases(flight: FlightRecords) -> list[str]:
    """In the order of a flight, for the legend."""
    used = {str(phase) for vehicle in flight.vehicles for phase in np.unique(vehicle.ticks.phase)}
    return [str(phase) for phase in FlightPhase if phase in used]


def draw_leaders(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Known leader of every vehicle."""

    def bar(vehicle: VehicleLog, interval: Interval, leader: Any) -> Bar | None:
        leader_id = int(leader)
        leads = leader_id == vehicle.vehicle_id
        label, hatch = ("leads", "//") if leads else (f"follows {leader_id}", "")
        return Bar(interval, pale(vehicle_look(leader_id)["color"]), hatch, label) if leader_id else None

    rows = [_states(vehicle, np.nan_to_num(vehicle.ticks.leader_id, nan=0.0), bar) for vehicle in flight.vehicles]
    caption = "The leader as each vehicle knew it; hatched: the vehicle itself. A gap: no leader is known."
    return _draw(rows, axis, "leaders", "Leader over time", caption)


def draw_flags(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure | None:
    """None where no flag was ever raised."""
    rows: list[BarRow] = []
    for vehicle in flight.vehicles:
        for flag, raised in sorted(vehicle.ticks.flags.items()):
            counts = counts_of(vehicle, flag)
            shown = ((raised & ~counts, FLAG_EXPECTED), (counts, FLAG_COUNTS))
            found = [
                Bar(one.interval, colour)
                for holds, colour in shown
                for one in runs(vehicle.ticks.time_s, holds, apart_s=0.1)
            ]
            rows.append((f"{vehicle.vehicle_id}: {flag}", found))
    if not rows:
        return None
    caption = (
        "Raised health flags of each vehicle. Dark: where they count, which is in formation"
        " (battery, fence and estimator: in the air); light: elsewhere, where some are expected."
    )
    return _draw(rows, axis, "flags", "Health flags over time", caption)


def _states(vehicle: VehicleLog, states: Anything, bar_of: Callable[[VehicleLog, Interval, Any], Bar | None]) -> BarRow:
    """A bar for each time in which the state (n,) of a vehicle is the same."""
    time_s = vehicle.ticks.time_s
    found = [
        bar_of(vehicle, interval, state)
        for piece in _recorded(time_s)
        for interval, state in stretches(time_s[piece], states[piece])
    ]
    return f"vehicle {vehicle.vehicle_id}", [bar for bar in found if bar]


def _recorded(time_s: np.ndarray) -> list[slice]:
    """The parts of a recording without gaps."""
    breaks = np.flatnonzero(np.diff(time_s) > GAP_S) + 1
    edges = [0, *breaks.tolist(), time_s.size]
    return [slice(first, last) for first, last in pairwise(edges) if last > first]


def _draw(
    rows: Sequence[BarRow], axis: TimeAxis, id_: str, title: str, caption: str, legend_of: Sequence[str] = ()
) -> DrawnFigure:
    figure = new_figure(0.27 * len(rows) + 0.05)
    axes = figure.subplots()
    for place, (_, bars) in enumerate(rows):
        for bar in bars:
            _draw_bar(axes, place, bar, axis)
    axes.set_yticks(range(len(rows)), [label for label, _ in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    dress_panel(axes, "", "")
    axes.grid(False, axis="y")
    dress_time([axes], axis)
    for phase in legend_of:
        colour, hatch = PHASES[phase]
        axes.bar(0, 0, color=colour, hatch=hatch, **EDGE, label=phase)
    finish(figure, [axes], max(LEFT_IN, 0.1 + 0.078 * max(len(label) for label, _ in rows)))
    return render(figure, id_, title, caption)


def _draw_bar(axes: Axes, place: int, bar: Bar, axis: TimeAxis) -> None:
    begins_s = bar.interval.begins_s
    lasts_s = max(bar.interval.lasts_s, 0.0012 * axis.ends_s)  # a short one must be seen
    axes.barh(place, lasts_s, left=begins_s, height=0.68, color=bar.colour, hatch=bar.hatch, **EDGE)
    if bar.label and lasts_s > LETTER_ROOM * len(bar.label) * axis.ends_s:
        box = {"boxstyle": "round,pad=0.1", "facecolor": bar.colour, "edgecolor": "none"} if bar.hatch else None
        axes.text(begins_s + lasts_s / 2.0, place, bar.label, ha="center", va="center", fontsize=7, bbox=box)


def draw_histograms(flight: FlightRecords) -> DrawnFigure:
    """Of the ticks in the air."""
    figure = new_figure(3.0)
    left, right = figure.subplots(1, 2, sharey=True)
    for vehicle in flight.vehicles:
        for axes, values_ms in zip((left, right), in_air_ms(vehicle), strict=True):
            _draw_histogram(axes, values_ms, vehicle.vehicle_id)
    panels = (
        (left, LATE_P99_MS, "lateness of the tick [ms]", "ticks in the air [-]"),
        (right, TO_COMMAND_P99_MS, "telemetry to command [ms]", ""),
    )
    for axes, limit_ms, x_label, y_label in panels:
        axes.axvline(limit_ms, label=f"limit of p99: {limit_ms:g} ms", **LIMIT)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlim(LEAST_MS, MOST_MS)
        axes.set_ylim(0.7, MOST_TICKS)
        dress_panel(axes, x_label, y_label, 2)
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), fontsize=SIZE - 1, frameon=False, handlelength=3.0)
    rows = 1 + len(flight.vehicles)
    figure.set_figheight(2.4 + LEGEND_ROW_IN * rows)
    below = (BOTTOM_IN + LEGEND_ROW_IN * rows + 0.1) / figure.get_figheight()
    figure.subplots_adjust(
        left=LEFT_IN / WIDTH_IN, right=1.0 - RIGHT_IN / WIDTH_IN, top=0.97, bottom=below, wspace=0.12
    )
    caption = (
        "Both axes are logarithmic; ticks that were exactly on time count as 0.01 ms. Limits are those of the findings."
    )
    return render(figure, "timing", "Timing of the ticks: histograms", caption)


def _draw_histogram(axes: Axes, values_ms: Floats, vehicle_id: int) -> None:
    known = values_ms[~np.isnan(values_ms)]
    if not known.size:
        return
    edges = np.geomspace(LEAST_MS, MOST_MS, BINS)
    counts, _ = np.histogram(np.clip(known, LEAST_MS, MOST_MS), edges)
    found = percentiles(known)
    label = f"vehicle {vehicle_id}: p50 {found.p50_ms:.2f}, p99 {found.p99_ms:.2f}, max {found.max_ms:.1f} ms"
    axes.stairs(np.where(counts > 0, counts, np.nan), edges, label=label, **vehicle_look(vehicle_id))
