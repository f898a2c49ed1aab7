"""Figures of values over time: altitude, distances, errors, PrC and weights, ages, battery, wind, filter, autopilots, lateness.

All are panels of curves below each other, with the same time axis.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from companion.link.tick import LATE_S
from companion.report.autopilot_logs import MatchedLog, Series
from companion.report.distances import PairDistance, in_formation
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.report.plotting import (
    COLUMNS,
    GREY,
    LIMIT,
    DrawnFigure,
    TimeAxis,
    curve_look,
    dress_panel,
    dress_time,
    finish,
    marked_pair_look,
    new_figure,
    plot,
    render,
    vehicle_look,
)
from companion.report.record_findings import LARGEST_POSITION_ERROR_M, LEAST_SATELLITES

MOST_PAIRS = 10  # for large fleets only the nearest pairs are drawn
MOST_PANELS = 12
SMOOTH_TICKS = 100  # 2 s: the estimate follows every gust and the noise
JUDGED = "Judged are all records; drawn are the smallest and largest of each moment."
LEAST_ERROR_M = 0.05  # upper end of the axis of errors, at the least
BLACK: dict[str, Any] = {"color": "#000000"}

Values = Callable[[VehicleLog], tuple[Floats, Floats]]
"""Times and values (n,) of a vehicle."""


@dataclass(frozen=True, slots=True)
class DrawnCurve:
    """Values (n,) over times (n,). Curves of one label share its entry in the legend."""

    label: str
    time_s: Floats
    values: Floats
    style: Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class CurvePanel:
    """Curves with one axis of values, which has `label` with its unit; `limits`: values with their names."""

    label: str
    curves: Sequence[DrawnCurve]
    limits: Sequence[tuple[float, str]] = ()
    low: float | None = None  # lower end of the axis; None: chosen from the curves
    high: float | None = None
    counts: bool = False  # the values are whole numbers


def _draw(
    axis: TimeAxis, panels: Sequence[CurvePanel], height_in: float, id_: str, title: str, caption: str
) -> DrawnFigure:
    figure = new_figure(height_in)
    places = list(figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0])
    for axes, panel in zip(places, panels, strict=True):
        for curve in panel.curves:
            plot(axes, curve.time_s, curve.values, curve.label, **curve.style)
        for value, name in panel.limits:
            axes.axhline(value, label=name, **LIMIT)
        axes.set_ylim(panel.low, panel.high)
        if panel.counts:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        dress_panel(axes, "", panel.label)
    dress_time(places, axis)
    finish(figure, places)
    return render(figure, id_, title, caption)


def _of_vehicles(flight: FlightRecords, values_of: Values, **style: Any) -> list[DrawnCurve]:
    """A curve for each vehicle, in its own look."""
    return [
        DrawnCurve(f"vehicle {one.vehicle_id}", *values_of(one), vehicle_look(one.vehicle_id) | style)
        for one in flight.vehicles
    ]


def draw_altitude(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Altitude of every vehicle."""
    curves = _of_vehicles(flight, lambda one: (one.ticks.time_s, one.ticks.position_enu_m[:, 2]))
    caption = "As estimated on board, in the fleet frame."
    return _draw(
        axis, [CurvePanel("altitude above the origin [m]", curves)], 1.8, "altitude", "Altitude over time", caption
    )


def draw_distances(flight: FlightRecords, pairs: Sequence[PairDistance], axis: TimeAxis) -> DrawnFigure:
    """The pair that came nearest is thick, with what the separation filter of its vehicles required."""
    curves = []
    for index, pair in reversed(list(enumerate(pairs[:MOST_PAIRS]))):
        label, style = f"{pair.pair[0]}-{pair.pair[1]}", marked_pair_look(pair.pair, index, 2 * COLUMNS)
        if index == 0 and pair.judged.any():
            label, style = f"{label}, smallest {pair.smallest_m:.2f} m", style | {"linewidth": 2.4}
            nearest = np.array([pair.smallest_at_s]), np.array([pair.smallest_m])
            curves.append(DrawnCurve("_", *nearest, BLACK | {"marker": "o", "markersize": 6, "zorder": 5}))
        curves.append(DrawnCurve(label, pair.time_s, np.where(pair.judged, pair.distance_m, np.nan), style))
    if pairs:
        required = _required(flight, pairs[0].pair)
        curves.append(DrawnCurve("required by the filter, nearest pair", *required, {"color": GREY, "linewidth": 1.2}))
    separation_m = flight.separation_m
    limits = [(separation_m, f"separation_m {separation_m:g} m")] if separation_m is not None else []
    farther = len(pairs) - MOST_PAIRS
    caption = (
        "Pairs with both vehicles in the air, from their recorded positions. A metre of height counts half, as"
        f" separation_m counts it. Each pair has the colours of its vehicles. {JUDGED}"
        + (f" {farther} pairs that stayed farther apart are left out." if farther > 0 else "")
    )
    panel = CurvePanel("distance [m]", curves, limits, low=0.0)
    return _draw(axis, [panel], 2.5, "distances", "Inter-distances over time", caption)


def _required(flight: FlightRecords, pair: tuple[int, int]) -> tuple[Floats, Floats]:
    """Required distance of the pair, where one of the two has the other as its nearest vehicle."""
    for own, other in (pair, pair[::-1]):
        ticks = next(vehicle.ticks for vehicle in flight.vehicles if vehicle.vehicle_id == own)
        shown = ticks.nearest == str(other)
        if shown.any():
            return ticks.time_s, np.where(shown, ticks.required_m, np.nan)
    return np.empty(0), np.empty(0)


def draw_errors(flight: FlightRecords, errors_m: Mapping[int, Floats], axis: TimeAxis) -> DrawnFigure:
    """Error to the slot of every vehicle; `errors_m` is per tick, by vehicle."""
    curves = _of_vehicles(flight, lambda one: (one.ticks.time_s, errors_m[one.vehicle_id]))
    inside = [errors_m[one.vehicle_id][in_formation(one)] for one in flight.vehicles]
    largest_m = max((float(np.nanmax(own, initial=0.0)) for own in inside if np.isfinite(own).any()), default=None)
    high_m = None if largest_m is None else max(LEAST_ERROR_M, 1.05 * largest_m)
    caption = f"|(x - d) - r|: position less its slot offset, to the leader's reference at that time. {JUDGED}" + (
        " The axis is that of the formation; before and after, larger errors leave it." if high_m else ""
    )
    panel = CurvePanel("error to slot [m]", curves, low=0.0, high=high_m)
    return _draw(axis, [panel], 1.9, "errors", "Error to the slot over time", caption)


def draw_prc(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """PrC of every vehicle, as steps. Curves of equal values lie side by side."""
    middle = (len(flight.vehicles) - 1) / 2.0
    apart = {vehicle_id: 0.06 * (index - middle) for index, vehicle_id in enumerate(flight.ids)}
    steps = _of_vehicles(
        flight,
        lambda one: _changes(one.ticks.time_s, one.ticks.prc + apart[one.vehicle_id]),
        drawstyle="steps-post",
    )
    caption = "1 is a leader, 2 has a leader as neighbour, and so on."
    panel = CurvePanel("PrC [-]", steps, counts=True)
    return _draw(axis, [panel], 1.3, "prc", "Priority coefficient (PrC) over time", caption)


def _changes(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Only where a value changes, and the ends."""
    if time_s.size < 2:
        return time_s, values
    keep = np.concatenate(([True], values[1:] != values[:-1]))
    keep[-1] = True
    return time_s[keep], values[keep]


def draw_weights(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure | None:
    """A panel for each vehicle that used neighbours with weights; None without any, as of a law that tells none."""
    users = [
        vehicle
        for vehicle in flight.vehicles
        if any(np.isfinite(use.weight).any() for use in vehicle.ticks.neighbours.values())
    ][:MOST_PANELS]
    if not users:
        return None
    panels = [
        CurvePanel(
            f"w of {one.vehicle_id} [-]",
            [
                DrawnCurve(f"of vehicle {other}", one.ticks.time_s, use.weight, vehicle_look(other))
                for other, use in one.ticks.neighbours.items()
            ],
            low=-0.05,
            high=1.05,
        )
        for one in users
    ]
    height_in = max(0.42, 0.8 - 0.06 * len(users)) * len(users)
    caption = "w_ij of eq. 6; a gap: not used."
    return _draw(axis, panels, height_in, "weights", "Weights of the neighbours over time", caption)


def draw_peer_ages(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """The oldest state of a neighbour that was used in each tick."""
    curves = _of_vehicles(flight, lambda one: (one.ticks.time_s, 1e3 * _oldest_s(one)))
    limits = []
    if flight.fleet:
        limit_ms = 1e3 * flight.fleet.peers.max_age_s
        limits = [(limit_ms, f"peers.max_age_s {limit_ms:g} ms")]
    panel = CurvePanel("age [ms]", curves, limits, low=0.0)
    caption = "An older state than the limit is not used."
    return _draw(axis, [panel], 1.5, "peer-ages", "Age of the oldest neighbour state used", caption)


def _oldest_s(vehicle: VehicleLog) -> Floats:
    ages = [use.age_s for use in vehicle.ticks.neighbours.values()]
    if not ages:
        return np.full(vehicle.ticks.time_s.size, np.nan)
    oldest = np.fmax.reduce(ages)
    return np.asarray(oldest, dtype=np.float64)


def draw_battery(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Charge of every vehicle, with the thresholds of the fleet file."""
    curves = _of_vehicles(flight, lambda one: (one.ticks.time_s, one.ticks.battery_percent))
    names = ("leave_below_percent", "land_below_percent")
    values = [(name, getattr(flight.fleet, name, None)) for name in names]
    limits = [(value, f"{name} {value:g} %") for name, value in values if value is not None]
    panel = CurvePanel("charge [%]", curves, limits, low=0.0, high=105.0)
    return _draw(axis, [panel], 1.5, "battery", "Battery over time", "As reported by the autopilots.")


def draw_wind(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Estimated acceleration by wind, east and north."""

    def along(axis_index: int) -> Values:
        def values_of(one: VehicleLog) -> tuple[Floats, Floats]:
            wind_m_s2 = one.ticks.wind_acceleration_enu_m_s2[:, axis_index]
            return one.ticks.time_s, np.where(one.ticks.flying, _smooth(wind_m_s2), np.nan)

        return values_of

    names = ("east [m/s²]", "north [m/s²]")
    panels = [CurvePanel(name, _of_vehicles(flight, along(i), linewidth=0.9)) for i, name in enumerate(names)]
    caption = "Acceleration by wind as each agent estimates it; in steady wind all vehicles agree. Drawn is the mean over 2 s."
    return _draw(axis, panels, 2.2, "wind", "Estimated wind over time", caption)


def _smooth(values: Floats) -> Floats:
    """The mean over SMOOTH_TICKS about each value."""
    if values.size < SMOOTH_TICKS:
        return values
    padded = np.pad(values, (SMOOTH_TICKS // 2, SMOOTH_TICKS - 1 - SMOOTH_TICKS // 2), mode="edge")
    sums = np.cumsum(np.concatenate(([0.0], padded)))
    return np.asarray((sums[SMOOTH_TICKS:] - sums[:-SMOOTH_TICKS]) / SMOOTH_TICKS, dtype=np.float64)


def draw_interventions(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """What the separation filter changed, and the distance that was left above the required one."""
    changed = _of_vehicles(flight, lambda one: (one.ticks.time_s, one.ticks.filter_changed_m_s2))
    left = _of_vehicles(flight, lambda one: (one.ticks.time_s, one.ticks.nearest_m - one.ticks.required_m))
    largest = max((float(curve.values.max(initial=0.0)) for curve in changed), default=0.0)
    panels = [
        CurvePanel("change [m/s²]", changed, low=0.0, high=max(1.0, 1.05 * largest)),
        CurvePanel("room [m]", left, [(0.0, "required distance")]),
    ]
    caption = (
        "Above: by how much the separation filter changed the commanded acceleration. Below: distance of the nearest"
        " vehicle or traffic less its required distance; the filter acts towards 0."
    )
    return _draw(axis, panels, 2.4, "interventions", "Separation filter: interventions and room", caption)


def draw_position_errors(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Horizontal position error that each estimator reports."""
    curves = _of_vehicles(flight, lambda one: (one.statuses.time_s, one.statuses.error_horizontal_m))
    panel = CurvePanel("one sigma, horizontal [m]", curves, low=0.0)
    caption = "From the recorded status reports, five a second."
    return _draw(axis, [panel], 1.5, "position-errors", "Position error as the estimators report it", caption)


def draw_lateness(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Lateness of every tick."""
    curves = _of_vehicles(flight, lambda one: (one.timing.time_s, one.timing.late_ms))
    panel = CurvePanel("lateness [ms]", curves, [(1e3 * LATE_S, f"one period, {1e3 * LATE_S:g} ms")], low=0.0)
    caption = "A tick that begins a period late is a missed tick."
    return _draw(axis, [panel], 1.5, "lateness", "Lateness of the ticks over time", caption)


def draw_autopilot_logs(flight: FlightRecords, matched: Sequence[MatchedLog], axis: TimeAxis) -> list[DrawnFigure]:
    """One figure for each log."""
    vehicles = {vehicle.vehicle_id: vehicle for vehicle in flight.vehicles}
    return [_draw_log(vehicles[one.vehicle_id], one, number, axis) for number, one in enumerate(matched, start=1)]


def _draw_log(vehicle: VehicleLog, matched: MatchedLog, number: int, axis: TimeAxis) -> DrawnFigure:
    log, by_s = matched.log, matched.offset_s
    rows: list[tuple[str, Series, float | None, str]] = [
        ("voltage [V]", log.voltage_v, None, ""),
        ("vibration [m/s²]", log.vibration_m_s2, log.vibration_limit_m_s2, "limit of vibration"),
        ("GPS error [m]", log.position_error_m, LARGEST_POSITION_ERROR_M, "limit of the GPS error"),
        ("satellites [-]", log.satellites, LEAST_SATELLITES, "least satellites"),
    ]
    panels = [CurvePanel("altitude [m]", _altitudes(vehicle, matched))]
    for label, series, limit, name in rows:
        if series.time_s.size:
            limits = [] if limit is None else [(limit, f"{name}: {limit:g}")]
            panels.append(CurvePanel(label, [_logged(series.shifted(by_s))], limits))
    missing = [label.split(" [")[0] for label, series, _, _ in rows if not series.time_s.size]
    caption = (
        f"{log.name}, {log.make}. Aligned by motion: {100.0 * matched.agreement:.0f} % agreement of the velocities; log"
        f" time {-by_s:.2f} s is 0 s here." + (f" The log has no {', '.join(missing)}." if missing else "")
    )
    title = f"Autopilot of vehicle {vehicle.vehicle_id}: its own log"
    return _draw(axis, panels, 0.85 * len(panels), f"autopilot-{number}", title, caption)


def _logged(series: Series) -> DrawnCurve:
    return DrawnCurve("log of the autopilot", series.time_s, series.values, curve_look(1))


def _altitudes(vehicle: VehicleLog, matched: MatchedLog) -> list[DrawnCurve]:
    """Both altitudes; the log's has its own zero, so the median difference is taken off."""
    own_s, own_m = vehicle.ticks.time_s, vehicle.ticks.position_enu_m[:, 2]
    curves = [DrawnCurve("recorded by the agent", own_s, own_m, curve_look(0))]
    log = matched.log.altitude_m.shifted(matched.offset_s)
    inside = (log.time_s >= own_s[0]) & (log.time_s <= own_s[-1])
    if inside.any():
        time_s, values_m = log.time_s[inside], log.values[inside]
        shift_m = float(np.nanmedian(np.interp(time_s, own_s, own_m) - values_m))
        curves.append(_logged(Series(time_s, values_m + shift_m)))
    return curves
