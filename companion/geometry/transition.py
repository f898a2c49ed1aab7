"""Transition between two formations: all slots move along straight lines with one time law.

Slots assigned by the smallest sum of squared distances do not cross on such paths. They keep at
least 1/sqrt(2) of the smaller of the two formations' separations (Turpin, Michael and Kumar, 2014).
The actual minimum distance of a pair is the minimum of a quadratic function.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import dist, hypot, inf

from companion.geometry.curves import PEAK_SPEED
from companion.types.values import Vector3

# Tolerance of a distance between slots. The ground computes with the slots that vehicles report, to 0.1 mm on each axis.
ROUNDING_M = 5e-4


def closest_approach(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> tuple[float, int, int]:
    """(smallest distance of two slots during the transition [m], their vehicles).

    (inf, 0, 0) for a single vehicle. Both formations have the same vehicles.
    """
    pairs = (
        (_closest_pair(before_enu_m[i], after_enu_m[i], before_enu_m[j], after_enu_m[j]), i, j)
        for i, j in combinations(sorted(before_enu_m), 2)
    )
    return min(pairs, default=(inf, 0, 0))


def longest_path_m(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> float:
    """Length of the longest path of any vehicle, m."""
    return max(dist(before_enu_m[i], after_enu_m[i]) for i in before_enu_m)


def peak_speed_m_s(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3], lasts_s: float) -> float:
    """Peak speed of the slot with the longest path, m/s."""
    return PEAK_SPEED * longest_path_m(before_enu_m, after_enu_m) / lasts_s


def _closest_pair(a0: Vector3, a1: Vector3, b0: Vector3, b1: Vector3) -> float:
    """Smallest distance of two slots; their difference moves along a straight line."""
    x, y, z = a0[0] - b0[0], a0[1] - b0[1], a0[2] - b0[2]
    dx, dy, dz = a1[0] - b1[0] - x, a1[1] - b1[1] - y, a1[2] - b1[2] - z
    way2 = dx * dx + dy * dy + dz * dz
    share = min(max(-(x * dx + y * dy + z * dz) / way2, 0.0), 1.0) if way2 > 0.0 else 0.0
    return hypot(x + share * dx, y + share * dy, z + share * dz)
