"""Static obstacles of a fleet file."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from companion.config.values import Coordinate, PositionM, Section
from companion.geometry.airspace import Cuboid, Cylinder, Obstacle

LOWEST_M, HIGHEST_M = -10_000.0, 10_000.0
PointM = tuple[Coordinate, Coordinate]


class CylinderObstacle(Section, frozen=True, tag_field="kind", tag="cylinder"):
    """An upright cylinder: a tree, a mast, a silo."""

    centre_enu_m: Annotated[PointM, Meta(description="x, y of the axis")]
    radius_m: Annotated[float, Meta(gt=0, le=1000, description="radius")]
    bottom_m: Annotated[Coordinate, Meta(description="z of the lower end; without a value far below the ground")] = (
        LOWEST_M
    )
    top_m: Annotated[Coordinate, Meta(description="z of the upper end; without a value above all vehicles")] = HIGHEST_M

    @property
    def body(self) -> Obstacle:
        return Cylinder(self.centre_enu_m, self.radius_m, self.bottom_m, self.top_m)


class BoxObstacle(Section, frozen=True, tag_field="kind", tag="box"):
    """A box along the axes of the fleet frame: a building, a wall."""

    min_enu_m: Annotated[PositionM, Meta(description="lowest x, y, z")]
    max_enu_m: Annotated[PositionM, Meta(description="highest x, y, z")]

    @property
    def body(self) -> Obstacle:
        return Cuboid(self.min_enu_m, self.max_enu_m)


ObstacleSection = CylinderObstacle | BoxObstacle
