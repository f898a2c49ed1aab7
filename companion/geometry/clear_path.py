"""Whether a path stays in the airspace: sampled as densely as the room at each position requires."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from math import dist

from companion.geometry.airspace import Airspace
from companion.geometry.vectors import plus
from companion.types.steps import Steps, whole
from companion.types.values import Vector3

SHORTEST_STEP_M = 0.25  # along a wall; deeper than half of it no path gets into the clearance unseen
ROUNDING_M = 1e-6


def first_conflict(
    airspace: Airspace, position_at: Callable[[float], Vector3], length: float, rate_m: float, around_m: float = 0.0
) -> Vector3 | None:
    """The first position of a path that is nearer than `around_m` to what the airspace excludes; None for a clear path.

    The path runs from parameter 0 to `length` and moves at most `rate_m` for each unit of it.
    """
    return whole(conflict_steps(airspace, position_at, length, rate_m, around_m))


def conflict_steps(
    airspace: Airspace, position_at: Callable[[float], Vector3], length: float, rate_m: float, around_m: float = 0.0
) -> Steps[Vector3 | None]:
    """`first_conflict`, a step for each position."""
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


def leg_conflict(airspace: Airspace, start_m: Vector3, end_m: Vector3, around_m: float = 0.0) -> Vector3 | None:
    """`first_conflict` of a straight line."""
    return whole(leg_conflict_steps(airspace, start_m, end_m, around_m))


def leg_conflict_steps(
    airspace: Airspace, start_m: Vector3, end_m: Vector3, around_m: float = 0.0
) -> Steps[Vector3 | None]:
    """`leg_conflict`, a step for each position."""
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
