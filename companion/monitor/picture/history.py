"""The last ten minutes, two points a second: for plots."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from companion.monitor.api import FleetView, HistoryPoint, HistorySample, VehicleView

PERIOD_S = 0.5
KEPT_S = 600.0


class HistoryRing:
    """Points in rising order of time. Vehicles of several fleets with the same id: the first fleet counts."""

    def __init__(self) -> None:
        self._points: deque[HistoryPoint] = deque(maxlen=int(KEPT_S / PERIOD_S))

    def is_due(self, time_s: float) -> bool:
        return not self._points or time_s - self._points[-1].time_s >= PERIOD_S - 1e-6

    def add(self, time_s: float, vehicles: Sequence[VehicleView], fleets: Sequence[FleetView]) -> None:
        """Vehicles that are silent are left out: old values are no history of now."""
        smallest = [f.smallest_separation_m for f in fleets if f.smallest_separation_m is not None]
        samples = {v.vehicle_id: _sample(v) for v in reversed(vehicles) if not v.silent}
        point = HistoryPoint(time_s, min(smallest, default=None), tuple(samples[i] for i in sorted(samples)))
        self._points.append(point)

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
