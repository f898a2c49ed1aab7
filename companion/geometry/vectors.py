"""Arithmetic on vectors of the world frame, and limits of scalars. Tuples, because arrays are slower for three numbers."""

from __future__ import annotations

from collections.abc import Collection
from math import hypot

from companion.types.values import Vector3


def plus(a: Vector3, b: Vector3) -> Vector3:
    """a + b."""
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2])


def minus(a: Vector3, b: Vector3) -> Vector3:
    """a - b."""
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def dot(a: Vector3, b: Vector3) -> float:
    """Inner product of a and b."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def scaled(vector: Vector3, factor: float) -> Vector3:
    """factor * vector."""
    x, y, z = vector
    return (x * factor, y * factor, z * factor)


def shortened(vector: Vector3, max_length: float) -> Vector3:
    """The vector, scaled down to `max_length` where it is longer."""
    length = hypot(*vector)
    return vector if length <= max_length else scaled(vector, max_length / length)


def mean(vectors: Collection[Vector3]) -> Vector3:
    """Mean of one or more vectors."""
    x, y, z = (sum(components) / len(vectors) for components in zip(*vectors, strict=True))
    return (x, y, z)


def extrapolated(position_m: Vector3, velocity_m_s: Vector3, seconds: float) -> Vector3:
    """Position after this time at constant velocity, m."""
    (x, y, z), (vx, vy, vz) = position_m, velocity_m_s
    return (x + vx * seconds, y + vy * seconds, z + vz * seconds)


def clamped(value: float, limit: float) -> float:
    """The value limited to [-limit, limit]."""
    if value > limit:
        return limit
    return -limit if value < -limit else value


def between(value: float, low: float, high: float) -> float:
    """The value limited to [low, high]; `high` where that is below `low`."""
    if value < low:
        value = low
    return high if value > high else value


def rounded(vector: Vector3, decimals: int) -> Vector3:
    """The vector with so many decimals. NaN and infinity stay."""
    x, y, z = vector
    return (round(x, decimals), round(y, decimals), round(z, decimals))
