"""What sections of our files are made of: no unknown key, and numbers with bounds and units."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta, Struct

MAX_DRAG_1_S = 10.0

VehicleId = Annotated[int, Meta(ge=1, le=250, description="MAVLink system id of the vehicle")]
Seconds = Annotated[float, Meta(gt=0, le=60)]
Coordinate = Annotated[float, Meta(ge=-10_000, le=10_000)]
PositionM = tuple[Coordinate, Coordinate, Coordinate]
HoverThrust = Annotated[float, Meta(ge=0.1, le=0.9)]
Drag = Annotated[float, Meta(ge=0, le=MAX_DRAG_1_S, description="deceleration by drag for each m/s through the air")]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """A section of a file."""
