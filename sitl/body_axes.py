"""The body's axes: FLU in the house, FRD in MAVLink. What companion.frames does for the world, for vectors in the body."""

from __future__ import annotations

from companion.types import Vector3


def frd_from_flu(vector_flu: Vector3) -> Vector3:
    """(forward, left, up) -> (forward, right, down); rates about these axes change in the same way."""
    forward, left, up = vector_flu
    return (forward, -left, -up)


flu_from_frd = frd_from_flu
