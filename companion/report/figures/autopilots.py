"""The autopilots' own logs beside the recordings: altitude, battery voltage, vibration, GPS."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from companion.report.autopilot.log import Series
from companion.report.autopilot.match import MatchedLog
from companion.report.figures.picture import DrawnFigure, picture
from companion.report.figures.style import LIMIT, TimeAxis, dress, dress_time, finish, look, new_figure, plot
from companion.report.findings.autopilot import LARGEST_POSITION_ERROR_M, LEAST_SATELLITES
from companion.report.flight import FlightRecords, VehicleLog


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
