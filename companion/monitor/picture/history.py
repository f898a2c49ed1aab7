"""The last ten minutes, two points a second: for plots."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from companion.monitor.api import FleetView, HistoryPoint, HistorySample, VehicleView

PERIOD_S = 0.5
KEPT_S = 600.0


class HistoryRing:
    """Points in rising order of time, one for each fleet."""

    def __init__(self) -> None:
        self._points: deque[HistoryPoint] = deque()

    def is_due(self, time_s: float) -> bool:
        return not self._points or time_s - self._points[-1].time_s >= PERIOD_S - 1e-6

    def add(self, time_s: float, vehicles: Sequence[VehicleView], fleets: Sequence[FleetView]) -> None:
        """Vehicles that are silent are left out: old values are no history of now."""
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
        altitude_m=vehicle.position_enu_m[2],
        error_to_slot_m=vehicle.error_to_slot_m,
        battery_percent=vehicle.battery_percent,
        late_p99_ms=vehicle.timing.late_p99_ms,
        nearest_m=vehicle.nearest.distance_m if vehicle.nearest else None,
    )
