"""Airspace of a fleet: the fence, a box with an optional polygon in the plane, and static obstacles.

Distances are signed: positive in the free airspace, negative outside the fence or inside an obstacle. A gap is a distance with
the unit vector in which it grows. No distance changes faster than the position, so a distance holds for a ball about it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from math import cos, dist, hypot, inf, pi, sin, sqrt

from msgspec import Struct

from companion.geometry.vectors import plus
from companion.types.steps import Steps
from companion.types.values import Vector3

Corner = tuple[float, float]
Gap = tuple[float, Vector3]
"""(distance m, unit vector in which it grows)."""
UP, DOWN = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
EAST, WEST, NORTH, SOUTH = (1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)
TOUCHES_M = 1e-9
GAPS_PER_STEP = 500  # distances to walls and obstacles
CIRCLE_CORNERS = 24  # a cylinder is drawn as a polygon with so many corners


class Cylinder(Struct, frozen=True, gc=False):
    """An upright cylinder."""

    centre_enu_m: Corner
    radius_m: float
    bottom_m: float
    top_m: float

    @property
    def outline_enu_m(self) -> tuple[Corner, ...]:
        """Corners seen from above, metres."""
        (x, y), angles = self.centre_enu_m, [2.0 * pi * k / CIRCLE_CORNERS for k in range(CIRCLE_CORNERS)]
        return tuple((x + self.radius_m * cos(angle), y + self.radius_m * sin(angle)) for angle in angles)

    def gap(self, position_enu_m: Vector3) -> Gap:
        """Distance from its surface."""
        x, y, z = position_enu_m
        dx, dy = x - self.centre_enu_m[0], y - self.centre_enu_m[1]
        away_m = hypot(dx, dy)
        nx, ny = (dx / away_m, dy / away_m) if away_m > TOUCHES_M else (1.0, 0.0)
        beside_m = away_m - self.radius_m
        above_m, upward = z - self.top_m, 1.0
        if self.bottom_m - z > above_m:
            above_m, upward = self.bottom_m - z, -1.0
        if beside_m > 0.0 and above_m > 0.0:
            distance_m = hypot(beside_m, above_m)
            share, rise = beside_m / distance_m, above_m / distance_m
            return distance_m, (nx * share, ny * share, upward * rise)
        return (beside_m, (nx, ny, 0.0)) if beside_m >= above_m else (above_m, (0.0, 0.0, upward))


class Cuboid(Struct, frozen=True, gc=False):
    """A box along the axes of the fleet frame."""

    min_enu_m: Vector3
    max_enu_m: Vector3

    @property
    def outline_enu_m(self) -> tuple[Corner, ...]:
        """Corners seen from above, metres."""
        (x0, y0, _), (x1, y1, _) = self.min_enu_m, self.max_enu_m
        return (x0, y0), (x1, y0), (x1, y1), (x0, y1)

    @property
    def bottom_m(self) -> float:
        return self.min_enu_m[2]

    @property
    def top_m(self) -> float:
        return self.max_enu_m[2]

    def gap(self, position_enu_m: Vector3) -> Gap:
        """Distance from its surface."""
        outside: list[float] = []
        signs: list[float] = []
        for p, low, high in zip(position_enu_m, self.min_enu_m, self.max_enu_m, strict=True):
            signs.append(1.0 if p - high >= low - p else -1.0)
            outside.append(max(p - high, low - p))
        x, y, z = (max(way_m, 0.0) for way_m in outside)
        distance_m = sqrt(x * x + y * y + z * z)
        if distance_m > 0.0:
            return distance_m, (signs[0] * x / distance_m, signs[1] * y / distance_m, signs[2] * z / distance_m)
        axis = outside.index(max(outside))
        normal = [0.0, 0.0, 0.0]
        normal[axis] = signs[axis]
        return outside[axis], (normal[0], normal[1], normal[2])


Obstacle = Cylinder | Cuboid


class Fence(Struct, frozen=True, gc=False):
    """A box with floor and ceiling, less what lies outside a polygon in the plane. The polygon may be concave."""

    min_enu_m: Vector3
    max_enu_m: Vector3
    corners_enu_m: tuple[Corner, ...] = ()  # corners of the polygon in order; empty for a plain box

    def contains(self, position_enu_m: Vector3) -> bool:
        """Whether a position lies inside. False for NaN."""
        x, y, z = position_enu_m
        low_x, low_y, low_z = self.min_enu_m
        high_x, high_y, high_z = self.max_enu_m
        in_box = low_x <= x <= high_x and low_y <= y <= high_y and low_z <= z <= high_z
        return in_box and (not self.corners_enu_m or in_polygon((x, y), self.corners_enu_m))

    def gaps(self, position_enu_m: Vector3, within_m: float = inf) -> list[Gap]:
        """Distances to the walls of the fence that are nearer than `within_m`.

        Inside the polygon each of its sides is a wall: a straight line would cut off parts of a concave one. Outside there is
        one wall, the nearest.
        """
        x, y, z = position_enu_m
        low_x, low_y, low_z = self.min_enu_m
        high_x, high_y, high_z = self.max_enu_m
        gaps: list[Gap] = []
        if x - low_x < within_m:
            gaps.append((x - low_x, EAST))
        if high_x - x < within_m:
            gaps.append((high_x - x, WEST))
        if y - low_y < within_m:
            gaps.append((y - low_y, NORTH))
        if high_y - y < within_m:
            gaps.append((high_y - y, SOUTH))
        if z - low_z < within_m:
            gaps.append((z - low_z, UP))
        if high_z - z < within_m:
            gaps.append((high_z - z, DOWN))
        if self.corners_enu_m:
            gaps += self.polygon_gaps(x, y, within_m)
        return gaps

    def polygon_gaps(self, x: float, y: float, within_m: float = inf) -> list[Gap]:
        """Those of the polygon alone, which has corners."""
        sides = _side_gaps(x, y, self.corners_enu_m)
        if in_polygon((x, y), self.corners_enu_m):
            return [gap for gap in sides if gap[0] < within_m]
        distance_m, (nx, ny, _) = min(sides)
        return [(-distance_m, (-nx, -ny, 0.0))]


class Airspace(Struct, frozen=True, gc=False):
    """Fence and obstacles, and the distance that vehicles keep from both."""

    fence: Fence
    obstacles: tuple[Obstacle, ...] = ()
    clearance_m: float = 0.0

    def room_m(self, position_enu_m: Vector3) -> float:
        """Distance to the nearest wall or obstacle, less the clearance."""
        gaps = [distance_m for distance_m, _ in self.fence.gaps(position_enu_m)]
        gaps += [obstacle.gap(position_enu_m)[0] for obstacle in self.obstacles]
        return min(gaps) - self.clearance_m

    def walls(self, position_enu_m: Vector3, within_m: float = inf) -> Iterator[Gap]:
        """Distances to obstacles and to sides of the polygon that are nearer than `within_m`; the box left out."""
        for obstacle in self.obstacles:
            if (gap := obstacle.gap(position_enu_m))[0] < within_m:
                yield gap
        if self.corners_enu_m:
            yield from self.fence.polygon_gaps(position_enu_m[0], position_enu_m[1], within_m)

    def positions_per_step(self, each: int = 1) -> int:
        """How many positions, each with so many distances to all walls, are a step of a check."""
        return max(1, GAPS_PER_STEP // (each * (6 + len(self.corners_enu_m) + len(self.obstacles))))

    @property
    def is_box(self) -> bool:
        """Without polygon and obstacles."""
        return not self.corners_enu_m and not self.obstacles

    @property
    def corners_enu_m(self) -> tuple[Corner, ...]:
        return self.fence.corners_enu_m


def in_polygon(point_m: Corner, corners_m: tuple[Corner, ...]) -> bool:
    """Whether a point lies inside a simple polygon: a ray to the east crosses its sides an odd number of times."""
    x, y = point_m
    inside = False
    x0, y0 = corners_m[-1]
    for x1, y1 in corners_m:
        if (y0 > y) != (y1 > y) and x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
            inside = not inside
        x0, y0 = x1, y1
    return inside


def crossing_sides(corners_m: tuple[Corner, ...]) -> tuple[int, int] | None:
    """Two sides, by the index of their first corner, that touch or cross without being adjacent; None in a simple polygon."""
    sides = list(zip(corners_m, corners_m[1:] + corners_m[:1], strict=True))
    for i, a in enumerate(sides):
        for j in range(i + 1, len(sides)):
            adjacent = j == i + 1 or (i == 0 and j == len(sides) - 1)
            if not adjacent and _crosses(*a, *sides[j]):
                return i, j
    return None


def area_m2(corners_m: tuple[Corner, ...]) -> float:
    """Area of a simple polygon."""
    sides = zip(corners_m, corners_m[1:] + corners_m[:1], strict=True)
    return abs(sum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in sides)) / 2.0


def _side_gaps(x: float, y: float, corners_m: Iterable[Corner]) -> list[Gap]:
    """Distance to each side of a polygon, with the unit vector from its nearest point."""
    corners = list(corners_m)
    gaps: list[Gap] = []
    x0, y0 = corners[-1]
    for x1, y1 in corners:
        sx, sy = x1 - x0, y1 - y0
        share = ((x - x0) * sx + (y - y0) * sy) / (sx * sx + sy * sy)
        share = min(max(share, 0.0), 1.0)
        dx, dy = x - x0 - share * sx, y - y0 - share * sy
        distance_m = hypot(dx, dy)
        if distance_m > TOUCHES_M:
            gaps.append((distance_m, (dx / distance_m, dy / distance_m, 0.0)))
        else:
            length_m = hypot(sx, sy)
            gaps.append((0.0, (-sy / length_m, sx / length_m, 0.0)))
        x0, y0 = x1, y1
    return gaps


def _crosses(a: Corner, b: Corner, c: Corner, d: Corner) -> bool:
    turns = (_turn(a, b, c), _turn(a, b, d), _turn(c, d, a), _turn(c, d, b))
    if turns[0] * turns[1] < 0.0 and turns[2] * turns[3] < 0.0:
        return True
    ends = ((a, b, c), (a, b, d), (c, d, a), (c, d, b))
    return any(turn == 0.0 and _between(*end) for turn, end in zip(turns, ends, strict=True))


def _turn(a: Corner, b: Corner, c: Corner) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _between(a: Corner, b: Corner, c: Corner) -> bool:
    """Whether c, on the line through a and b, lies between them."""
    return min(a[0], b[0]) <= c[0] <= max(a[0], b[0]) and min(a[1], b[1]) <= c[1] <= max(a[1], b[1])


SHORTEST_STEP_M = 0.25  # along a wall; deeper than half of it no path gets into the clearance unseen
ROUNDING_M = 1e-6


def conflict_steps(
    airspace: Airspace, position_at: Callable[[float], Vector3], length: float, rate_m: float, around_m: float = 0.0
) -> Steps[Vector3 | None]:
    """The first position of a path that is nearer than `around_m` to what the airspace excludes; None for a clear path.

    The path runs from parameter 0 to `length` and moves at most `rate_m` for each unit of it. A step for each position.
    """
    at = 0.0
    while True:
        position = position_at(at)
        room_m = airspace.room_m(position) - around_m
        if not room_m >= -ROUNDING_M:
            return position
        yield
        if at >= length:
            return None
        at = min(length, at + max(room_m, SHORTEST_STEP_M) / rate_m)


def leg_conflict_steps(
    airspace: Airspace, start_m: Vector3, end_m: Vector3, around_m: float = 0.0
) -> Steps[Vector3 | None]:
    """`conflict_steps` of a straight line."""
    length_m = dist(start_m, end_m)
    if length_m == 0.0:
        return (yield from conflict_steps(airspace, lambda _: start_m, 0.0, 1.0, around_m))

    def position_at(way_m: float) -> Vector3:
        share = way_m / length_m
        (x, y, z), (tx, ty, tz) = start_m, end_m
        return (x + share * (tx - x), y + share * (ty - y), z + share * (tz - z))

    return (yield from conflict_steps(airspace, position_at, length_m, 1.0, around_m))


def room_for(airspace: Airspace, rft_enu_m: Vector3, slots_enu_m: Sequence[Vector3], around_m: float) -> bool:
    """Whether all slots about a position of the RFT are clear; `around_m` is the distance of the outermost slot."""
    if airspace.room_m(rft_enu_m) >= around_m:
        return True
    return all(airspace.room_m(plus(rft_enu_m, slot)) >= -ROUNDING_M for slot in slots_enu_m)


def nearest_kind(airspace: Airspace, position_enu_m: Vector3) -> str:
    """What excludes a position: the fence, or an obstacle by its number in the fleet file."""
    gaps = [obstacle.gap(position_enu_m)[0] for obstacle in airspace.obstacles]
    walls: Iterable[float] = (distance_m for distance_m, _ in airspace.fence.gaps(position_enu_m))
    if gaps and min(gaps) < min(walls):
        return f"obstacles[{gaps.index(min(gaps))}]"
    return "the fence"
