"""Rotations of many vehicles as quaternions (4, k): w, x, y, z, FLU to ENU."""

from __future__ import annotations

import numpy as np

from companion.stability.arrays import FloatArray


def product(first: FloatArray, then: FloatArray) -> FloatArray:
    """The rotation `first`, followed by `then` about the rotated body axes."""
    w, x, y, z = first
    a, b, c, d = then
    turned = np.empty_like(first)
    turned[0] = w * a - x * b - y * c - z * d
    turned[1] = x * a + w * b + y * d - z * c
    turned[2] = y * a + w * c + z * b - x * d
    turned[3] = z * a + w * d + x * c - y * b
    return turned


def quaternion_of_turns(angles_rad: FloatArray) -> FloatArray:
    """Quaternions of small angles (3, k) about the body axes."""
    quaternion = np.empty((4, angles_rad.shape[1]))
    quaternion[0] = 1.0
    np.multiply(angles_rad, 0.5, out=quaternion[1:])
    quaternion /= np.sqrt(np.square(quaternion).sum(axis=0))
    return quaternion


def euler_rad(attitude: FloatArray) -> FloatArray:
    """Roll, pitch, yaw (3, k) of unit quaternions (4, k), FLU in ENU."""
    w, x, y, z = attitude
    euler = np.empty((3, w.size))
    np.arctan2(2.0 * (w * x + y * z), 1.0 - 2.0 * (x * x + y * y), out=euler[0])
    np.arcsin(np.clip(2.0 * (w * y - z * x), -1.0, 1.0), out=euler[1])
    np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z), out=euler[2])
    return euler


def quaternion_of_euler(roll_rad: FloatArray, pitch_rad: FloatArray, yaw_rad: FloatArray) -> FloatArray:
    """Quaternions (4, k) of Rz(yaw) Ry(pitch) Rx(roll)."""
    halves = 0.5 * np.stack([roll_rad, pitch_rad, yaw_rad])
    (cr, cp, cy), (sr, sp, sy) = np.cos(halves), np.sin(halves)
    return np.stack(
        [
            cr * cp * cy + sr * sp * sy,
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
        ]
    )
