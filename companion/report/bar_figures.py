"""Figures of states as bars over time: phases, leader, flags."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from matplotlib.axes import Axes

from companion.link.tick import LATE_S
from companion.report.findings import Interval, runs, stretches
from companion.report.flight import FlightRecords, Floats
from companion.report.flight_findings import counting
from companion.report.plotting import (
    BOTTOM_IN,
    LEFT_IN,
    LEGEND_ROW_IN,
    LIMIT,
    RIGHT_IN,
    WIDTH_IN,
    DrawnFigure,
    TimeAxis,
    dress,
    dress_time,
    finish,
    look,
    new_figure,
    picture,
    plot,
)
from companion.report.record_findings import LATE_P99_MS, TO_COMMAND_P99_MS, in_air_ms, percentiles
from companion.types.flight import FlightPhase

LETTER_ROOM = 0.012
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


@dataclass(frozen=True, slots=True)
class Bar:
    interval: Interval
    colour: str
    hatch: str = ""
    label: str = ""


def draw_phases(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Phase of every agent."""
    rows = []
    for vehicle in flight.vehicles:
        ticks = vehicle.ticks
        bars = []
        for piece in _recorded(ticks.time_s):
            for interval, phase in stretches(ticks.time_s[piece], ticks.phase[piece]):
                colour, hatch = PHASES.get(str(phase), ("#ffffff", "xx"))
                bars.append(Bar(interval, colour, hatch, str(phase)))
        rows.append((f"vehicle {vehicle.vehicle_id}", bars))
    caption = "Phase of each agent. A gap: nothing is recorded."
    return _picture(rows, axis, "phases", "Flight phases over time", caption, used_phases(flight))


def used_phases(flight: FlightRecords) -> list[str]:
    """In the order of a flight, for the legend."""
    used = {str(phase) for vehicle in flight.vehicles for phase in np.unique(vehicle.ticks.phase)}
    return [str(phase) for phase in FlightPhase if phase in used]


def draw_leaders(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Known leader of every vehicle."""
    shades = ("#cfe3f1", "#f6e3b4", "#9cc9a9", "#e7bcae", "#d9cfe8")
    rows = []
    for vehicle in flight.vehicles:
        ticks = vehicle.ticks
        bars = []
        for piece in _recorded(ticks.time_s):
            known = np.nan_to_num(ticks.leader_id[piece], nan=0.0)
            for interval, leader in stretches(ticks.time_s[piece], known):
                leader_id = int(leader)
                if leader_id:
                    label = "leads" if leader_id == vehicle.vehicle_id else f"follows {leader_id}"
                    hatch = "//" if leader_id == vehicle.vehicle_id else ""
                    bars.append(Bar(interval, shades[leader_id % len(shades)], hatch, label))
        rows.append((f"vehicle {vehicle.vehicle_id}", bars))
    caption = "The leader as each vehicle knew it; hatched: the vehicle itself. A gap: no leader is known."
    return _picture(rows, axis, "leaders", "Leader over time", caption)


def draw_flags(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure | None:
    """None where no flag was ever raised."""
    rows = []
    for vehicle in flight.vehicles:
        ticks = vehicle.ticks
        for flag, raised in sorted(ticks.flags.items()):
            counts = counting(vehicle, flag)
            found = [Bar(one.interval, "#d4d4d4") for one in runs(ticks.time_s, raised & ~counts, apart_s=0.1)]
            found += [Bar(one.interval, "#8c3b2a") for one in runs(ticks.time_s, counts, apart_s=0.1)]
            rows.append((f"{vehicle.vehicle_id}: {flag}", found))
    if not rows:
        return None
    caption = (
        "Raised health flags of each vehicle. Dark: where they count, which is in formation"
        " (battery, fence and estimator: in the air); light: elsewhere, where some are expected."
    )
    return _picture(rows, axis, "flags", "Health flags over time", caption)


def _recorded(time_s: np.ndarray) -> list[slice]:
    """The parts of a recording without gaps."""
    breaks = np.flatnonzero(np.diff(time_s) > GAP_S) + 1
    edges = [0, *breaks.tolist(), time_s.size]
    return [slice(first, last) for first, last in pairwise(edges) if last > first]


def _picture(
    rows: Sequence[tuple[str, Sequence[Bar]]],
    axis: TimeAxis,
    id_: str,
    title: str,
    caption: str,
    legend_of: Sequence[str] = (),
) -> DrawnFigure:
    figure = new_figure(0.27 * len(rows) + 0.05)
    axes = figure.subplots()
    for place, (_, bars) in enumerate(rows):
        for bar in bars:
            _draw(axes, place, bar, axis)
    axes.set_yticks(range(len(rows)), [label for label, _ in rows])
    axes.set_ylim(len(rows) - 0.4, -0.6)
    dress(axes, "")
    axes.grid(False, axis="y")
    dress_time([axes], axis)
    if legend_of:
        for phase in legend_of:
            colour, hatch = PHASES[phase]
            axes.bar(0, 0, color=colour, hatch=hatch, edgecolor="#555555", linewidth=0.6, label=phase)
    finish(figure, [axes], max(LEFT_IN, 0.1 + 0.078 * max(len(label) for label, _ in rows)))
    return picture(figure, id_, title, caption)


def _draw(axes: Axes, place: int, bar: Bar, axis: TimeAxis) -> None:
    least_s = 0.0012 * axis.ends_s  # a short one must be seen
    lasts_s = max(bar.interval.lasts_s, least_s)
    axes.barh(
        place,
        lasts_s,
        left=bar.interval.begins_s,
        height=0.68,
        color=bar.colour,
        hatch=bar.hatch,
        edgecolor="#555555",
        linewidth=0.5,
    )
    if bar.label and lasts_s > LETTER_ROOM * len(bar.label) * axis.ends_s:
        axes.text(
            bar.interval.begins_s + lasts_s / 2.0,
            place,
            bar.label,
            ha="center",
            va="center",
            fontsize=7,
            bbox={"boxstyle": "round,pad=0.1", "facecolor": bar.colour, "edgecolor": "none"} if bar.hatch else None,
        )


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
