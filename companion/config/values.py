"""Types that sections of our files share: no unknown keys, and numbers with bounds and units.

What a key means is written once, in the docstring of its section, from which the configuration reference is made
(docs/generate). The unit is in the name of the field. `about` describes a type that several sections use, `written` a text.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import suppress
from ipaddress import IPv4Address
from typing import Annotated, Any

from msgspec import Meta, Struct

from companion.geometry.airspace import Cuboid, Cylinder, Obstacle
from companion.types.values import FLEET_NAME


def written(pattern: str, words: str) -> Meta:
    """Texts of this pattern. `words` describe it in messages."""
    return Meta(pattern=pattern, extra={"format": words})


def is_multicast(address: str) -> bool:
    """Whether HOST:PORT is a group: it is joined on one network interface, and what is sent to it stays there."""
    with suppress(ValueError):
        return IPv4Address(address.rpartition(":")[0]).is_multicast
    return False


def about(description: str, **bounds: Any) -> Meta:
    """What a key means, for the configuration reference, with the bounds of its values (those of `msgspec.Meta`)."""
    return Meta(description=description, **bounds)


MAX_DRAG_1_S = 10.0
FLEET_NAME_WORDS = "at most 41 lower-case letters, digits, - and _, a letter or digit first"

Name = Annotated[str, written(FLEET_NAME, FLEET_NAME_WORDS)]
VehicleId = Annotated[int, about("MAVLink system id of the vehicle", ge=1, le=250)]
Text = Annotated[str, Meta(min_length=1)]
NetworkAddress = Annotated[
    str,
    written(r"^[A-Za-z0-9._-]+:[0-9]{1,5}$", "HOST:PORT with an IPv4 address or a name, like 192.168.1.11:7447"),
]
Seconds = Annotated[float, Meta(gt=0, le=60)]
Coordinate = Annotated[float, Meta(ge=-10_000, le=10_000)]
PositionM = tuple[Coordinate, Coordinate, Coordinate]
HoverThrust = Annotated[float, about("normalized thrust in a hover, 0 to 1", ge=0.1, le=0.9)]
Drag = Annotated[
    float,
    about("deceleration by drag per speed through the air (linear drag over mass)", ge=0, le=MAX_DRAG_1_S),
]


class Section(Struct, frozen=True, forbid_unknown_fields=True):
    """A section of a file."""


def overlaid(common: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """A plain section with own keys in place of the common ones, key by key; what is no section replaces the whole value."""
    return {**common, **{key: _laid_over(common.get(key), value) for key, value in own.items()}}


def _laid_over(common: Any, own: Any) -> Any:
    return overlaid(common, own) if isinstance(common, Mapping) and isinstance(own, Mapping) else own


LOWEST_M, HIGHEST_M = -10_000.0, 10_000.0
PointM = tuple[Coordinate, Coordinate]


class CylinderObstacle(Section, frozen=True, tag_field="kind", tag="cylinder"):
    """An upright cylinder: a tree, a mast, a silo.

    centre_enu_m: x, y of the axis
    radius_m: radius
    bottom_m: z of the lower end; without a value far below the ground
    top_m: z of the upper end; without a value above all vehicles
    """

    centre_enu_m: PointM
    radius_m: Annotated[float, Meta(gt=0, le=1000)]
    bottom_m: Coordinate = LOWEST_M
    top_m: Coordinate = HIGHEST_M

    @property
    def body(self) -> Obstacle:
        return Cylinder(self.centre_enu_m, self.radius_m, self.bottom_m, self.top_m)

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Keys that contradict others, each with the problem."""
        if self.bottom_m >= self.top_m:
            yield "bottom_m", f"{self.bottom_m:g}: expected less than top_m, {self.top_m:g}"


class BoxObstacle(Section, frozen=True, tag_field="kind", tag="box"):
    """A box along the axes of the fleet frame: a building, a wall.

    min_enu_m: lowest x, y, z
    max_enu_m: highest x, y, z
    """

    min_enu_m: PositionM
    max_enu_m: PositionM

    @property
    def body(self) -> Obstacle:
        return Cuboid(self.min_enu_m, self.max_enu_m)

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Keys that contradict others, each with the problem."""
        for axis, low, high in zip("xyz", self.min_enu_m, self.max_enu_m, strict=True):
            if low >= high:
                yield "min_enu_m", f"{axis} is {low:g}, expected less than max_enu_m's {high:g}"


ObstacleSection = CylinderObstacle | BoxObstacle
