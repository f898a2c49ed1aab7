"""A fixed point."""

from __future__ import annotations

from typing import Self

from companion.config.reference.base import BaseReference
from companion.config.values import PositionM


class PointReference(BaseReference, frozen=True, tag_field="kind", tag="point"):
    """A fixed point: r = point, r' = 0.

    point_enu_m: the point
    """

    TITLE, POSITION, MOVES = "Point", "point_enu_m", False

    point_enu_m: PositionM

    @classmethod
    def first(cls, size_m: float, height_m: float) -> Self:
        del size_m
        return cls(point_enu_m=(0.0, 0.0, height_m))


KIND = PointReference
