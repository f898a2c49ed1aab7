"""Settling time of an error: one definition for predictions, flights and batches."""

from __future__ import annotations

import numpy as np

from companion.stability.arrays import FloatArray

SETTLED_WITHIN_M = 0.10
STAY_S = 2.0


def settle_time_s(
    times_s: FloatArray, error_m: FloatArray, within_m: float = SETTLED_WITHIN_M, stay_s: float = STAY_S
) -> float | None:
    """Seconds from the first of evenly spaced times (n,) until the error (n,) stays within `within_m`.

    None if it is not inside for at least the last `stay_s`: an oscillation that is inside only at
    the end has not settled.
    """
    outside = np.flatnonzero(error_m > within_m)
    first_inside = int(outside[-1]) + 1 if outside.size else 0
    sample_s = float(times_s[1] - times_s[0]) if times_s.size > 1 else 0.0
    if first_inside == times_s.size or times_s[-1] - times_s[first_inside] < stay_s - sample_s / 2:
        return None
    return float(times_s[first_inside] - times_s[0])
