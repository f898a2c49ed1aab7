"""What `GET /metrics` answers to Prometheus: the values of a snapshot. docs/metrics.md has the table.

Labels have the fleet's name and numbers, and words of this program only; no text of a vehicle. A silent vehicle has its age and
`companion_vehicle_up` 0; its other values are left out, so that an old value never looks like a present one.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import hypot, isfinite
from typing import Generic, TypeVar

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, generate_latest
from prometheus_client.metrics_core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from companion.monitor.api import FleetView, Snapshot, VehicleView
from companion.monitor.vehicle_view import fresh_position_enu_m, is_old
from companion.types.code_table import SEVERITIES
from companion.types.flight import FlightPhase, HealthFlag, Role
from companion.types.values import FLEET_NAME

CONTENT_TYPE = CONTENT_TYPE_LATEST
OF_VEHICLE, OF_FLEET = ("fleet", "vehicle"), ("fleet",)

View = TypeVar("View")
Value = float | None
Values = Value | Mapping[str, Value]


@dataclass(frozen=True)  # without slots: Generic sets an attribute
class Measure(Generic[View]):
    """One metric. `values` gives its value, or one for each value of the further label `by`; None is left out.

    A counter's name ends in _total. `if_silent`: also of a vehicle that does not report.
    """

    name: str
    help: str
    values: Callable[[View], Values]
    by: str = ""
    if_silent: bool = False

    @property
    def is_counter(self) -> bool:
        return self.name.endswith("_total")


def _quantiles(p50_ms: float, p99_ms: float, max_ms: float) -> dict[str, Value]:
    return {"0.5": p50_ms / 1e3, "0.99": p99_ms / 1e3, "1": max_ms / 1e3}


def _flags(vehicle: VehicleView) -> dict[str, Value]:
    raised = {flag.code for flag in vehicle.flags}
    return {str(flag): float(flag in raised) for flag in HealthFlag}


def _percent(value: float | None) -> Value:
    return None if value is None else value / 100.0


def _position_errors(vehicle: VehicleView) -> dict[str, Value]:
    if is_old(vehicle) or vehicle.position_error_m is None:
        return {}
    horizontal_m, vertical_m = vehicle.position_error_m
    return {"horizontal": horizontal_m, "vertical": vertical_m}


def _altitude_m(vehicle: VehicleView) -> float | None:
    place_enu_m = fresh_position_enu_m(vehicle)
    return place_enu_m[2] if place_enu_m else None


def _speed_m_s(vehicle: VehicleView) -> float | None:
    velocity_enu_m_s = vehicle.velocity_enu_m_s
    return None if is_old(vehicle) or velocity_enu_m_s is None else hypot(*velocity_enu_m_s)


def _v(
    name: str, text: str, values: Callable[[VehicleView], Values], by: str = "", if_silent: bool = False
) -> Measure[VehicleView]:
    return Measure(f"companion_vehicle_{name}", text, values, by, if_silent)


def _f(name: str, text: str, values: Callable[[FleetView], Values]) -> Measure[FleetView]:
    return Measure(f"companion_fleet_{name}", text, values)


UP = _v(
    "up",
    "1 while the vehicle reports, 0 when it is silent or has never reported",
    lambda v: not v.silent,
    if_silent=True,
)
VEHICLE_MEASURES: tuple[Measure[VehicleView], ...] = (
    UP,
    _v("report_age_seconds", "Time since the last status report", lambda v: v.age_s, "", True),
    _v("report_rate_hertz", "Status reports received per second", lambda v: v.report_rate_hz),
    _v("data_age_seconds", "Age of the position: on board, and since the report", lambda v: v.data_age_s),
    _v(
        "phase",
        "1 for the present flight phase, 0 for the others",
        lambda v: {str(phase): float(v.phase == phase) for phase in FlightPhase},
        "phase",
    ),
    _v("flag", "1 for a raised health flag, 0 for the others", _flags, "flag"),
    _v("armed", "1 while the motors are armed", lambda v: v.armed),
    _v("leader", "1 while the vehicle is leader", lambda v: v.role == Role.LEADER),
    _v("battery_ratio", "Battery charge, 0 to 1", lambda v: _percent(v.battery_percent)),
    _v("altitude_meters", "Height above the fleet's origin", _altitude_m),
    _v("speed_meters_per_second", "Speed", _speed_m_s),
    _v(
        "position_error_meters", "One sigma of the position by the autopilot's estimator", _position_errors, "direction"
    ),
    _v("slot_error_meters", "Distance from its slot", lambda v: v.error_to_slot_m),
    _v(
        "nearest_distance_meters",
        "Distance of the nearest vehicle or traffic, as the separation filter counts it",
        lambda v: v.nearest.distance_m if v.nearest else None,
    ),
    _v(
        "nearest_required_meters",
        "Distance that the separation filter requires of it",
        lambda v: v.nearest.required_m if v.nearest else None,
    ),
    _v(
        "separation_change_meters_per_second_squared",
        "Change of the commanded acceleration by the separation filter, 0 without one",
        lambda v: v.nearest.changed_m_s2 if v.nearest else None,
    ),
    _v("prc", "Priority coefficient: 1 is a leader", lambda v: v.prc),
    _v("fresh_peers", "Vehicles of the fleet that it receives", lambda v: len(v.peers)),
    _v("leader_beacon_age_seconds", "Age of the newest leader beacon", lambda v: v.leader_beacon_age_s),
    _v("tick_rate_hertz", "Ticks of the control loop per second", lambda v: v.timing.rate_hz),
    _v(
        "tick_lateness_seconds",
        "Start of a tick after its due time, by quantile since it entered formation",
        lambda v: _quantiles(v.timing.late_p50_ms, v.timing.late_p99_ms, v.timing.late_max_ms),
        "quantile",
    ),
    _v("ticks_missed_total", "Periods without a tick", lambda v: v.timing.missed),
    _v(
        "telemetry_to_command_seconds",
        "From a position's arrival to its setpoint, by quantile since it entered formation",
        lambda v: {
            "0.5": v.timing.telemetry_to_command_p50_ms / 1e3,
            "0.99": v.timing.telemetry_to_command_p99_ms / 1e3,
        },
        "quantile",
    ),
    _v("cpu_ratio", "Use of one core by the agent, 0 to 1", lambda v: v.timing.cpu_percent / 100.0),
    _v("memory_bytes", "Resident memory of the agent", lambda v: v.timing.memory_mb * 1e6),
    _v("rejected_total", "Messages that the vehicle has rejected", lambda v: v.rejected),
    _v("unsecured", "1 where strangers in the network can command it", lambda v: v.network.security == "none"),
)
FLEET_MEASURES: tuple[Measure[FleetView], ...] = (
    _f("vehicles", "Vehicles of the fleet that ever reported", lambda f: len(f.vehicle_ids)),
    _f("leaders", "Leaders that report", lambda f: len(f.leader_ids)),
    _f(
        "smallest_separation_meters",
        "Smallest distance of two vehicles, as separation_m counts it",
        lambda f: f.smallest_separation_m,
    ),
    _f(
        "separation_trend_meters_per_second",
        "Its change over five seconds; negative while two vehicles close",
        lambda f: f.separation_trend_m_s,
    ),
    _f("lambda_min", "Smallest eigenvalue of the interaction matrix", lambda f: f.lambda_min),
    _f("settling_seconds", "Predicted time to a tenth of an error", lambda f: f.settling_s),
    _f("link_margin_meters", "How much farther apart the weakest neighbours may get", lambda f: f.link_margin_m),
)
# Measures of the server itself; `_of_server` computes their values.
SERVER_MEASURES: dict[str, str] = {
    "companion_monitor_snapshot_timestamp_seconds": "Unix time of the values, in a replay that of the flight",
    "companion_monitor_replay": "1 while the monitor shows a recording",
    "companion_monitor_unreachable_endpoints": "Endpoints of vehicles that cannot be reached",
    "companion_monitor_alarms": "Alarms that are not acknowledged, by fleet and severity",
}


def exposition(snapshot: Snapshot) -> bytes:
    """The text format of Prometheus, of CONTENT_TYPE."""
    registry = CollectorRegistry(auto_describe=False)
    registry.register(_Collector(snapshot))
    return generate_latest(registry)


class _Collector(Collector):
    def __init__(self, snapshot: Snapshot) -> None:
        self._snapshot = snapshot

    def collect(self) -> Iterator[Metric]:
        vehicles = [v for v in self._snapshot.vehicles if re.fullmatch(FLEET_NAME, v.fleet)]
        fleets = [f for f in self._snapshot.fleets if re.fullmatch(FLEET_NAME, f.name)]
        for measure in VEHICLE_MEASURES:
            metric = _family(measure, OF_VEHICLE)
            for vehicle in vehicles:
                if measure.if_silent or not vehicle.silent:
                    _add(metric, measure, vehicle, (vehicle.fleet, str(vehicle.vehicle_id)))
            if measure is UP:
                for name, vehicle_id in ((f.name, i) for f in fleets for i in f.missing_ids):
                    metric.add_metric((name, str(vehicle_id)), 0.0)
            yield metric
        for of_fleet in FLEET_MEASURES:
            metric = _family(of_fleet, OF_FLEET)
            for fleet in fleets:
                _add(metric, of_fleet, fleet, (fleet.name,))
            yield metric
        yield from _of_server(self._snapshot, [fleet.name for fleet in fleets])


def _family(measure: Measure[View], labels: tuple[str, ...]) -> CounterMetricFamily | GaugeMetricFamily:
    names = (*labels, measure.by) if measure.by else labels
    kind = CounterMetricFamily if measure.is_counter else GaugeMetricFamily
    return kind(measure.name, measure.help, labels=names)


def _add(
    metric: CounterMetricFamily | GaugeMetricFamily, measure: Measure[View], view: View, labels: tuple[str, ...]
) -> None:
    """The samples of one vehicle or fleet; values that are unknown or not finite are left out."""
    values = measure.values(view)
    for by, value in values.items() if isinstance(values, Mapping) else (("", values),):
        if value is not None and isfinite(value):
            metric.add_metric((*labels, by) if measure.by else labels, float(value))


def _of_server(snapshot: Snapshot, fleets: list[str]) -> Iterator[Metric]:
    values = {
        "companion_monitor_snapshot_timestamp_seconds": snapshot.time_s,
        "companion_monitor_replay": float(snapshot.replay is not None),
        "companion_monitor_unreachable_endpoints": float(len(snapshot.unreachable)),
    }
    for name, value in values.items():
        yield GaugeMetricFamily(name, SERVER_MEASURES[name], value=value)
    name = "companion_monitor_alarms"
    alarms = GaugeMetricFamily(name, SERVER_MEASURES[name], labels=("fleet", "severity"))
    for fleet in fleets:
        for severity in SEVERITIES:
            open_ = [a for a in snapshot.alarms if (a.fleet, a.severity, a.acknowledged) == (fleet, severity, False)]
            alarms.add_metric((fleet, severity), len(open_))
    yield alarms
