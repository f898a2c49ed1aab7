"""Speed at which a vehicle may still approach what it must not touch, and how that speed changes with the distance."""

from __future__ import annotations

from math import sqrt


def approach_speed(distance_m: float, deceleration_m_s2: float, slope_1_s: float) -> tuple[float, float]:
    """(speed m/s, its derivative by the distance 1/s): sqrt(2 a s) far away, and proportional to the distance near it.

    The square root alone has an infinite slope at distance 0, which no vehicle can follow; the straight line touches it at
    a/k^2, as in ArduPilot's `sqrt_controller`. Negative for a negative distance: the speed to leave at.
    """
    straight_m = deceleration_m_s2 / (slope_1_s * slope_1_s)
    if distance_m <= straight_m:
        return slope_1_s * distance_m, slope_1_s
    speed_m_s = sqrt(2.0 * deceleration_m_s2 * (distance_m - 0.5 * straight_m))
    return speed_m_s, deceleration_m_s2 / speed_m_s
