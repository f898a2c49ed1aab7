"""From one formation to another: all slots move in step along straight lines, by one law of time.

Slots that are assigned by the least sum of squared distances never cross on such paths, and keep at least 1/sqrt(2) of the
smaller of the two formations' separations (Turpin, Michael and Kumar, 2014). What a pair really keeps is a quadratic's minimum.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from math import dist, hypot, inf

from companion.geometry.curves import PEAK_SPEED
from companion.types import Vector3

ROUNDING_M = 1e-6  # what turning and scaling slots may take from a distance


def closest(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> tuple[float, int, int]:
    """(least distance of any two slots on the way, whose they are), infinite for one alone. Both have the same vehicles."""
    pairs = (
        (_closest_pair(before_enu_m[i], after_enu_m[i], before_enu_m[j], after_enu_m[j]), i, j)
        for i, j in combinations(sorted(before_enu_m), 2)
    )
    return min(pairs, default=(inf, 0, 0))


def longest_way_m(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3]) -> float:
    """Of any vehicle."""
    return max(dist(before_enu_m[i], after_enu_m[i]) for i in before_enu_m)


def fastest_m_s(before_enu_m: Mapping[int, Vector3], after_enu_m: Mapping[int, Vector3], lasts_s: float) -> float:
    """The speed of the slot with the longest way, half way."""
    return PEAK_SPEED * longest_way_m(before_enu_m, after_enu_m) / lasts_s


def _closest_pair(a0: Vector3, a1: Vector3, b0: Vector3, b1: Vector3) -> float:
    """Their difference moves along a straight line, whatever the law of time."""
    x, y, z = a0[0] - b0[0], a0[1] - b0[1], a0[2] - b0[2]
    dx, dy, dz = a1[0] - b1[0] - x, a1[1] - b1[1] - y, a1[2] - b1[2] - z
    way2 = dx * dx + dy * dy + dz * dz
    share = min(max(-(x * dx + y * dy + z * dz) / way2, 0.0), 1.0) if way2 > 0.0 else 0.0
    return hypot(x + share * dx, y + share * dy, z + share * dz)
