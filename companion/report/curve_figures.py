"""Figures of values over time: altitude, distances, errors, PrC and weights, age of peers, battery, wind, filter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from companion.report.autopilot_logs import MatchedLog, Series
from companion.report.distances import PairDistance
from companion.report.flight import FlightRecords, Floats, VehicleLog
from companion.report.plotting import (
    GREY,
    LIMIT,
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
from companion.report.record_findings import LARGEST_POSITION_ERROR_M, LEAST_SATELLITES

MOST_PAIRS = 10  # of large fleets only the nearest pairs are drawn
MOST_PANELS = 12
SMOOTH_TICKS = 100  # 2 s: the estimate follows every gust and the noise
JUDGED = "Judged are all records; drawn are the smallest and largest of each moment."


def draw_altitude(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Altitude of every vehicle."""
    figure = new_figure(1.8)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        ticks = vehicle.ticks
        plot(axes, ticks.time_s, ticks.position_enu_m[:, 2], f"vehicle {vehicle.vehicle_id}", **look(index))
    dress(axes, "altitude above the origin [m]")
    dress_time([axes], axis)
    finish(figure, [axes])
    return picture(figure, "altitude", "Altitude over time", "As estimated on board, in the fleet frame.")


def draw_distances(flight: FlightRecords, pairs: Sequence[PairDistance], axis: TimeAxis) -> DrawnFigure:
    """The pair that came nearest is highlighted, with what the separation filter of its vehicles required."""
    figure = new_figure(2.5)
    axes = figure.subplots()
    for index, pair in reversed(list(enumerate(pairs[:MOST_PAIRS]))):
        label = f"{pair.pair[0]} - {pair.pair[1]}"
        judged_m = np.where(pair.judged, pair.distance_m, np.nan)
        if index == 0 and pair.judged.any():
            style = {"color": "#000000", "linewidth": 2.2}
            label += f", smallest {pair.smallest_m:.2f} m"
            axes.plot(pair.smallest_at_s, pair.smallest_m, "o", color="#000000", markersize=6, zorder=5)
        else:
            style = look(index) | {"linewidth": 1.0}
        plot(axes, pair.time_s, judged_m, label, **style)
    if pairs:
        required_s, required_m = _required(flight, pairs[0].pair)
        plot(axes, required_s, required_m, "required by the filter, nearest pair", color=GREY, linewidth=1.2)
    if flight.separation_m is not None:
        axes.axhline(flight.separation_m, label=f"separation_m {flight.separation_m:g} m", **LIMIT)
    axes.set_ylim(bottom=0.0)
    dress(axes, "distance [m]")
    dress_time([axes], axis)
    finish(figure, [axes])
    left_out = (
        f" {len(pairs) - MOST_PAIRS} pairs that stayed farther apart are left out." if len(pairs) > MOST_PAIRS else ""
    )
    caption = (
        "Pairs with both vehicles in the air, from their recorded positions. A metre of height counts half, as"
        f" separation_m counts it. {JUDGED}{left_out}"
    )
    return picture(figure, "distances", "Inter-distances over time", caption)


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
    figure = new_figure(1.9)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        plot(axes, vehicle.ticks.time_s, errors_m[vehicle.vehicle_id], f"vehicle {vehicle.vehicle_id}", **look(index))
    axes.set_ylim(bottom=0.0)
    dress(axes, "error to slot [m]")
    dress_time([axes], axis)
    finish(figure, [axes])
    caption = f"|(x - d) - r|: position less its slot offset, to the leader's reference at that time. {JUDGED}"
    return picture(figure, "errors", "Error to the slot over time", caption)


def draw_prc(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """PrC of every vehicle, as steps."""
    figure = new_figure(1.3)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        # Curves of equal values lie side by side.
        shifted = vehicle.ticks.prc + 0.06 * (index - (len(flight.vehicles) - 1) / 2.0)
        axes.step(
            *_changes(vehicle.ticks.time_s, shifted), where="post", label=f"vehicle {vehicle.vehicle_id}", **look(index)
        )
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    axes.margins(y=0.12)
    dress(axes, "PrC [-]")
    dress_time([axes], axis)
    finish(figure, [axes])
    return picture(
        figure, "prc", "Priority coefficient (PrC) over time", "1 is a leader, 2 has a leader as neighbour, and so on."
    )


def _changes(time_s: Floats, values: Floats) -> tuple[Floats, Floats]:
    """Only where a value changes, and the ends."""
    if time_s.size < 2:
        return time_s, values
    keep = np.concatenate(([True], values[1:] != values[:-1]))
    keep[-1] = True
    return time_s[keep], values[keep]


def draw_weights(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure | None:
    """A panel for each vehicle that used neighbours; None without any."""
    users = [vehicle for vehicle in flight.vehicles if vehicle.ticks.neighbours][:MOST_PANELS]
    if not users:
        return None
    places = {vehicle_id: index for index, vehicle_id in enumerate(_all_ids(flight))}
    figure = new_figure(max(0.42, 0.8 - 0.06 * len(users)) * len(users))
    panels = list(figure.subplots(len(users), 1, sharex=True, squeeze=False)[:, 0])
    shown: set[int] = set()
    for axes, vehicle in zip(panels, users, strict=True):
        for other, use in vehicle.ticks.neighbours.items():
            label = "_" if other in shown else f"of neighbour {other}"
            shown.add(other)
            plot(axes, vehicle.ticks.time_s, use.weight, label, **look(places[other]))
        axes.set_ylim(-0.05, 1.05)
        dress(axes, f"w of {vehicle.vehicle_id} [-]")
    dress_time(panels, axis)
    finish(figure, panels)
    return picture(figure, "weights", "Weights of the neighbours over time", "w_ij of eq. 6; a gap: not used.")


def _all_ids(flight: FlightRecords) -> list[int]:
    """Recorded vehicles in their order, then those that are only known as neighbours."""
    others = {other for vehicle in flight.vehicles for other in vehicle.ticks.neighbours}
    return [*flight.ids, *sorted(others - set(flight.ids))]


def draw_peer_ages(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """The oldest state of a neighbour that was used in each tick."""
    figure = new_figure(1.5)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        plot(axes, vehicle.ticks.time_s, 1e3 * _oldest_s(vehicle), f"vehicle {vehicle.vehicle_id}", **look(index))
    if flight.fleet:
        limit_ms = 1e3 * flight.fleet.peers.max_age_s
        axes.axhline(limit_ms, label=f"peers.max_age_s {limit_ms:g} ms", **LIMIT)
    axes.set_ylim(bottom=0.0)
    dress(axes, "age [ms]")
    dress_time([axes], axis)
    finish(figure, [axes])
    return picture(
        figure, "peer-ages", "Age of the oldest neighbour state used", "An older state than the limit is not used."
    )


def _oldest_s(vehicle: VehicleLog) -> Floats:
    ages = [use.age_s for use in vehicle.ticks.neighbours.values()]
    if not ages:
        return np.full(vehicle.ticks.time_s.size, np.nan)
    oldest = np.fmax.reduce(ages)
    return np.asarray(oldest, dtype=np.float64)


def draw_battery(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Charge of every vehicle, with the thresholds of the fleet file."""
    figure = new_figure(1.5)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        ticks = vehicle.ticks
        plot(axes, ticks.time_s, ticks.battery_percent, f"vehicle {vehicle.vehicle_id}", **look(index))
    fleet = flight.fleet
    for name in ("leave_below_percent", "land_below_percent"):
        value = getattr(fleet, name) if fleet else None
        if value is not None:
            axes.axhline(value, label=f"{name} {value:g} %", **LIMIT)
    axes.set_ylim(0.0, 105.0)
    dress(axes, "charge [%]")
    dress_time([axes], axis)
    finish(figure, [axes])
    return picture(figure, "battery", "Battery over time", "As reported by the autopilots.")


def draw_wind(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Estimated acceleration by wind, east and north."""
    figure = new_figure(2.2)
    panels = list(figure.subplots(2, 1, sharex=True))
    for index, vehicle in enumerate(flight.vehicles):
        ticks = vehicle.ticks
        for axes, column in zip(panels, ticks.wind_acceleration_enu_m_s2.T[:2], strict=True):
            shown = np.where(ticks.flying, _smooth(column), np.nan)
            plot(axes, ticks.time_s, shown, f"vehicle {vehicle.vehicle_id}", **look(index) | {"linewidth": 0.9})
    dress(panels[0], "east [m/s²]")
    dress(panels[1], "north [m/s²]")
    dress_time(panels, axis)
    finish(figure, panels)
    caption = "Acceleration by wind as each agent estimates it; in steady wind all vehicles agree. Drawn is the mean over 2 s."
    return picture(figure, "wind", "Estimated wind over time", caption)


def _smooth(values: Floats) -> Floats:
    """The mean over SMOOTH_TICKS about each value."""
    if values.size < SMOOTH_TICKS:
        return values
    padded = np.pad(values, (SMOOTH_TICKS // 2, SMOOTH_TICKS - 1 - SMOOTH_TICKS // 2), mode="edge")
    sums = np.cumsum(np.concatenate(([0.0], padded)))
    return np.asarray((sums[SMOOTH_TICKS:] - sums[:-SMOOTH_TICKS]) / SMOOTH_TICKS, dtype=np.float64)


def draw_interventions(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """What the separation filter changed, and the room that was left."""
    figure = new_figure(2.4)
    above, below = figure.subplots(2, 1, sharex=True)
    for index, vehicle in enumerate(flight.vehicles):
        ticks = vehicle.ticks
        plot(above, ticks.time_s, ticks.filter_changed_m_s2, f"vehicle {vehicle.vehicle_id}", **look(index))
        plot(below, ticks.time_s, ticks.nearest_m - ticks.required_m, f"vehicle {vehicle.vehicle_id}", **look(index))
    below.axhline(0.0, label="required distance", **LIMIT)
    above.set_ylim(bottom=0.0, top=max(1.0, above.get_ylim()[1]))
    dress(above, "change [m/s²]")
    dress(below, "room [m]")
    dress_time([above, below], axis)
    finish(figure, [above, below])
    caption = (
        "Above: by how much the separation filter changed the commanded acceleration. Below: distance of the nearest"
        " vehicle or traffic less its required distance; the filter acts towards 0."
    )
    return picture(figure, "interventions", "Separation filter: interventions and room", caption)


def draw_position_errors(flight: FlightRecords, axis: TimeAxis) -> DrawnFigure:
    """Horizontal position error that each estimator reports."""
    figure = new_figure(1.5)
    axes = figure.subplots()
    for index, vehicle in enumerate(flight.vehicles):
        statuses = vehicle.statuses
        plot(axes, statuses.time_s, statuses.error_horizontal_m, f"vehicle {vehicle.vehicle_id}", **look(index))
    axes.set_ylim(bottom=0.0)
    dress(axes, "one sigma, horizontal [m]")
    dress_time([axes], axis)
    finish(figure, [axes])
    return picture(
        figure,
        "position-errors",
        "Position error as the estimators report it",
        "From the recorded status reports, five a second.",
    )


def draw_autopilot_logs(flight: FlightRecords, matched: Sequence[MatchedLog], axis: TimeAxis) -> list[DrawnFigure]:
    """One figure for each log."""
    vehicles = {vehicle.vehicle_id: vehicle for vehicle in flight.vehicles}
    return [_figure(vehicles[one.vehicle_id], one, number, axis) for number, one in enumerate(matched, start=1)]


def _figure(vehicle: VehicleLog, matched: MatchedLog, number: int, axis: TimeAxis) -> DrawnFigure:
    log, by_s = matched.log, matched.offset_s
    shown: list[tuple[str, Series, float | None, str]] = [
        ("voltage [V]", log.voltage_v, None, ""),
        ("vibration [m/s²]", log.vibration_m_s2, log.vibration_limit_m_s2, "limit of vibration"),
        ("GPS error [m]", log.position_error_m, LARGEST_POSITION_ERROR_M, "limit of the GPS error"),
        ("satellites [-]", log.satellites, LEAST_SATELLITES, "least satellites"),
    ]
    present = [row for row in shown if row[1].time_s.size]
    figure = new_figure(0.85 * (1 + len(present)))
    panels = list(figure.subplots(1 + len(present), 1, sharex=True, squeeze=False)[:, 0])
    _altitudes(panels[0], vehicle, matched)
    for axes, (label, series, limit, limit_label) in zip(panels[1:], present, strict=True):
        plot(axes, series.time_s + by_s, series.values, "log of the autopilot", **look(1))
        if limit is not None:
            axes.axhline(limit, label=f"{limit_label}: {limit:g}", **LIMIT)
        dress(axes, label)
    dress_time(panels, axis)
    finish(figure, panels)
    missing = [label.split(" [")[0] for label, series, _, _ in shown if not series.time_s.size]
    caption = (
        f"{log.name}, {log.make}. Aligned by motion: {100.0 * matched.agreement:.0f} % agreement of the velocities; log"
        f" time {-by_s:.2f} s is 0 s here." + (f" The log has no {', '.join(missing)}." if missing else "")
    )
    return picture(figure, f"autopilot-{number}", f"Autopilot of vehicle {vehicle.vehicle_id}: its own log", caption)


def _altitudes(axes: Axes, vehicle: VehicleLog, matched: MatchedLog) -> None:
    """Both altitudes; the log's has its own zero, so the median difference is taken off."""
    ticks, log = vehicle.ticks, matched.log
    plot(axes, ticks.time_s, ticks.position_enu_m[:, 2], "recorded by the agent", **look(0))
    time_s = log.altitude_m.time_s + matched.offset_s
    inside = (time_s >= ticks.time_s[0]) & (time_s <= ticks.time_s[-1])
    if inside.any():
        recorded_m = np.interp(time_s[inside], ticks.time_s, ticks.position_enu_m[:, 2])
        shift_m = float(np.nanmedian(recorded_m - log.altitude_m.values[inside]))
        plot(axes, time_s[inside], log.altitude_m.values[inside] + shift_m, "log of the autopilot", **look(1))
    dress(axes, "altitude [m]")
