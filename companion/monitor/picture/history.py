"""The last ten minutes, two points a second: for plots."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from math import inf

from companion.monitor.api import FleetView, HistoryPoint, HistorySample, VehicleView
from companion.monitor.picture.vehicle_view import is_old

PERIOD_S = 0.5
KEPT_S = 600.0


class HistoryRing:
    """Points in rising order of time, one for each fleet."""

    def __init__(self) -> None:
        self._points: deque[HistoryPoint] = deque()
        self._added_s = -inf

    def is_due(self, now_s: float) -> bool:
        """By the clock of the reports: Unix time may be set back."""
        return now_s - self._added_s >= PERIOD_S - 1e-6

    def add(self, now_s: float, time_s: float, vehicles: Sequence[VehicleView], fleets: Sequence[FleetView]) -> None:
        """Vehicles that are silent are left out: old values are no history of now."""
        self._added_s = now_s
        while self._points and self._points[-1].time_s >= time_s:  # the clock was set back
            self._points.pop()
        for fleet in fleets:
            samples = tuple([_sample(v) for v in vehicles if v.fleet == fleet.name and not v.silent])
            self._points.append(HistoryPoint(time_s, fleet.name, fleet.smallest_separation_m, samples))
        while self._points and self._points[0].time_s <= time_s - KEPT_S + 1e-6:
            self._points.popleft()

    def points(self) -> tuple[HistoryPoint, ...]:
        return tuple(self._points)


def _sample(vehicle: VehicleView) -> HistorySample:
    return HistorySample(
        vehicle_id=vehicle.vehicle_id,
        altitude_m=None if is_old(vehicle) else vehicle.position_enu_m[2],
        error_to_slot_m=vehicle.error_to_slot_m,
        battery_percent=vehicle.battery_percent,
        late_p99_ms=vehicle.timing.late_p99_ms,
        nearest_m=vehicle.nearest.distance_m if vehicle.nearest else None,
    )
