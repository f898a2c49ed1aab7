"""Rotations by small angles about the body's own axes."""

from __future__ import annotations

from math import sqrt

from companion.geometry.frames import Quaternion
from companion.types.values import Vector3

SmallTurn = tuple[float, float, float, float]
"""Half of the angles about x, y and z [rad], and the norm of the quaternion (1, a, b, c) that they make."""

NO_TURN: SmallTurn = (0.0, 0.0, 0.0, 1.0)


def small_turn(angles_rad: Vector3) -> SmallTurn:
    a, b, c = 0.5 * angles_rad[0], 0.5 * angles_rad[1], 0.5 * angles_rad[2]
    return (a, b, c, sqrt(1.0 + a * a + b * b + c * c))


def back(turn: SmallTurn) -> SmallTurn:
    """The opposite rotation."""
    a, b, c, norm = turn
    return (-a, -b, -c, norm)


def turned(quaternion: Quaternion, turn: SmallTurn) -> Quaternion:
    """A unit quaternion after this rotation."""
    w, x, y, z = quaternion
    a, b, c, norm = turn
    return (
        (w - x * a - y * b - z * c) / norm,
        (x + w * a + y * c - z * b) / norm,
        (y + w * b + z * a - x * c) / norm,
        (z + w * c + x * b - y * a) / norm,
    )
