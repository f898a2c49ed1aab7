"""Curves through given points: piecewise quintic, with continuous position, velocity and acceleration."""

from __future__ import annotations

from array import array
from bisect import bisect_right
from collections.abc import Iterable, Sequence
from itertools import chain, pairwise

from companion.geometry.curves import Coefficients, Curve, Motion, polynomial
from companion.types.values import ZERO3, Vector3

AXES = range(3)


def table(times_s: Sequence[float], motions: Iterable[Motion]) -> Curve:
    """Through these motions at these rising times; at rest in the first place before, and in the last one after them."""
    values = array(
        "d", chain.from_iterable(chain.from_iterable(motions))
    )  # 9 for each time, without an object for each
    last = len(times_s) - 1

    def at(time_s: float) -> Motion:
        index = bisect_right(times_s, time_s) - 1
        begin = 9 * min(max(index, 0), last)
        if not 0 <= index < last:
            x, y, z = values[begin : begin + 3]
            return (x, y, z), ZERO3, ZERO3
        lasts_s = times_s[index + 1] - times_s[index]
        u, rate, rate2 = (time_s - times_s[index]) / lasts_s, 1.0 / lasts_s, 1.0 / lasts_s**2
        ends = [(values[begin + axis : begin + 9 : 3], values[begin + 9 + axis : begin + 18 : 3]) for axis in AXES]
        (x, dx, ddx), (y, dy, ddy), (z, dz, ddz) = [
            polynomial(_between(before, after, lasts_s), u) for before, after in ends
        ]
        return (x, y, z), (dx * rate, dy * rate, dz * rate), (ddx * rate2, ddy * rate2, ddz * rate2)

    return at


def through(times_s: Sequence[float], points_m: Sequence[Vector3]) -> Curve:
    """Through the points at their rising times, from rest to rest; it stops where two points in a row are equal.

    Between two stops it is the cubic spline that begins and ends at rest. Its first and last piece are quintic instead, so that
    the acceleration is zero at the stops.
    """
    motions: list[Motion] = [(point, ZERO3, ZERO3) for point in points_m]
    begin = 0
    for end in range(1, len(points_m)):
        if end == len(points_m) - 1 or points_m[end] == points_m[end + 1] or points_m[end] == points_m[end - 1]:
            for index, inner in enumerate(
                _inner_motions(times_s[begin : end + 1], points_m[begin : end + 1]), begin + 1
            ):
                motions[index] = inner
            begin = end
    return table(times_s, motions)


def _inner_motions(times_s: Sequence[float], points_m: Sequence[Vector3]) -> list[Motion]:
    """Those of the cubic spline at all points but the first and the last, where its velocity is zero."""
    steps_s = [b - a for a, b in pairwise(times_s)]
    inner = range(1, len(points_m) - 1)
    velocities: list[list[float]] = []
    accelerations: list[list[float]] = []
    for axis in AXES:
        slopes = [(b[axis] - a[axis]) / h for (a, b), h in zip(pairwise(points_m), steps_s, strict=True)]
        # Thomas' algorithm for h[i] v[i-1] + 2 (h[i-1] + h[i]) v[i] + h[i-1] v[i+1] = 3 (h[i] s[i-1] + h[i-1] s[i])
        factors, values = [0.0], [0.0]
        for i in inner:
            before, after = steps_s[i - 1], steps_s[i]
            divisor = 2.0 * (before + after) - after * factors[-1]
            right = 3.0 * (after * slopes[i - 1] + before * slopes[i])
            values.append((right - after * values[-1]) / divisor)
            factors.append(before / divisor)
        along = [0.0]
        for i in reversed(inner):
            along.insert(0, values[i] - factors[i] * along[0])
        along.insert(0, 0.0)
        velocities.append(along)
        accelerations.append(
            [0.0, *((6.0 * slopes[i] - 4.0 * along[i] - 2.0 * along[i + 1]) / steps_s[i] for i in inner)]
        )
    (vx, vy, vz), (ax, ay, az) = velocities, accelerations
    return [(points_m[i], (vx[i], vy[i], vz[i]), (ax[i], ay[i], az[i])) for i in inner]


def _between(before: Sequence[float], after: Sequence[float], lasts_s: float) -> Coefficients:
    """Quintic with these positions, velocities and accelerations at u = 0 and u = 1."""
    (p, v, a), (q, w, b) = before, after
    v, w, a, b, way = v * lasts_s, w * lasts_s, a * lasts_s**2, b * lasts_s**2, q - p
    return (
        p,
        v,
        a / 2.0,
        10.0 * way - 6.0 * v - 4.0 * w - 1.5 * a + 0.5 * b,
        -15.0 * way + 8.0 * v + 7.0 * w + 1.5 * a - b,
        6.0 * way - 3.0 * v - 3.0 * w - 0.5 * a + 0.5 * b,
    )
