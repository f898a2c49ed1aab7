"""Vectors of the world frame, and gravity."""

from __future__ import annotations

Vector3 = tuple[float, float, float]
ZERO3: Vector3 = (0.0, 0.0, 0.0)
GRAVITY_M_S2 = 9.80665
