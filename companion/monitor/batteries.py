"""How long batteries last, by the charge that they lost in the last minute. Pure."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from companion.monitor.api import BatteryView, VehicleView

WINDOW_S = 60.0
SAMPLE_S = 2.0
LEAST_S = 30.0  # autopilots report whole percents: of a shorter time the slope would be noise
MOST_LEFT_MIN = 180.0  # more is no flight time of a quadrotor: it stands on the ground, or is on mains

Samples = deque[tuple[float, float]]  # time [s], charge [%]


class Batteries:
    """The charges of the vehicles of one fleet over the last minute."""

    def __init__(self) -> None:
        self._samples: dict[int, Samples] = {}

    def lowest(self, now_s: float, vehicles: Sequence[VehicleView]) -> BatteryView | None:
        """Of the vehicles that report a charge; None without one. To be called again and again, with `now_s` rising."""
        charges = {v.vehicle_id: v.battery_percent for v in vehicles if not v.silent and v.battery_percent is not None}
        self._samples = {i: self._samples.get(i) or Samples() for i in charges}
        for vehicle_id, percent in charges.items():
            samples = self._samples[vehicle_id]
            if samples and now_s < samples[-1][0]:  # a replay has gone back
                samples.clear()
            if not samples or now_s - samples[-1][0] >= SAMPLE_S:
                samples.append((now_s, percent))
            while samples[0][0] < now_s - WINDOW_S or percent > samples[0][1]:  # charged, or another battery
                samples.popleft()
                if not samples:
                    samples.append((now_s, percent))
        if not charges:
            return None
        lowest = min(charges, key=lambda i: (charges[i], i))
        return BatteryView(lowest, charges[lowest], left_min(self._samples[lowest], charges[lowest]))


def left_min(samples: Samples, percent: float) -> float | None:
    """By the straight line through the samples."""
    if samples[-1][0] - samples[0][0] < LEAST_S:
        return None
    mean_s = sum(t for t, _ in samples) / len(samples)
    mean_percent = sum(charge for _, charge in samples) / len(samples)
    spread = sum((t - mean_s) ** 2 for t, _ in samples)
    percent_s = sum((t - mean_s) * (charge - mean_percent) for t, charge in samples) / spread
    if percent_s >= 0.0 or (minutes := percent / -percent_s / 60.0) > MOST_LEFT_MIN:
        return None
    return round(minutes, 1)
