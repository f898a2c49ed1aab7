"""Distance of two vehicles as the limit `separation_m` counts it.

Every check against `separation_m` uses this metric: fleet files, formation changes, paths and the separation filter.
"""

from __future__ import annotations

from math import hypot

from companion.types.values import Vector3

HEIGHT_WEIGHT = 0.5
"""What a metre of height counts for, compared with a horizontal metre: two vehicles above each other need twice the distance.

The downwash of a quadrotor reaches far below it and hardly to the side. Preiss, Hoenig, Ayanian and Sukhatme ("Downwash-aware
trajectory planning for large quadrotor teams", IROS 2017) measured ellipsoids that are 2.5 times as tall as wide.
"""


def separation_distance_m(a_enu_m: Vector3, b_enu_m: Vector3) -> float:
    """Distance of two positions in the metric of `separation_m`, m."""
    return hypot(a_enu_m[0] - b_enu_m[0], a_enu_m[1] - b_enu_m[1], HEIGHT_WEIGHT * (a_enu_m[2] - b_enu_m[2]))


def counted(position_enu_m: Vector3, has_height: bool) -> Vector3:
    """The position in coordinates whose Euclidean distance is `separation_distance_m`.

    Without `has_height` each vehicle keeps its own altitude, and only the horizontal distance counts.
    """
    x, y, z = position_enu_m
    return (x, y, HEIGHT_WEIGHT * z if has_height else 0.0)
