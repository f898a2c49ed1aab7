"""Checks of fence and obstacles of a fleet file, and of paths of the formation in this airspace."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise

from companion.config.fleet import FleetConfig
from companion.config.obstacles import BoxObstacle, CylinderObstacle
from companion.config.reference import FIELD_OF_POSITION, Lapping, Reference, WaypointsReference
from companion.config.validation import Problem
from companion.geometry.airspace import Airspace, area_m2, crossing_sides
from companion.geometry.clear_path import conflict_steps, leg_conflict_steps, nearest_kind
from companion.geometry.turning import reach_m
from companion.geometry.vectors import plus
from companion.types.steps import Steps, coarser
from companion.types.values import Vector3

SMALLEST_AREA_M2 = 1.0


def airspace_problems(fleet: FleetConfig, where: str = "") -> Iterator[Problem]:
    """Fence and obstacles that cannot be used. `where` is the path of the fleet's section."""
    envelope = fleet.envelope
    lows, highs = envelope.fence_min_enu_m, envelope.fence_max_enu_m
    for axis, low, high in zip("xyz", lows, highs, strict=True):
        if low >= high:
            yield Problem(
                f"{where}envelope.fence_min_enu_m", f"{axis} is {low}, expected less than fence_max_enu_m's {high}"
            )
        elif high - low <= 2.0 * envelope.clearance_m:
            text = f"{envelope.clearance_m:g} leaves no room along {axis}, where the fence is {high - low:g} m wide"
            yield Problem(f"{where}envelope.clearance_m", text)
    yield from _polygon(fleet, f"{where}envelope.fence_corners_enu_m")
    for index, obstacle in enumerate(fleet.obstacles):
        match obstacle:
            case CylinderObstacle(bottom_m=bottom_m, top_m=top_m) if bottom_m >= top_m:
                yield Problem(
                    f"{where}obstacles[{index}].bottom_m", f"{bottom_m:g}: expected less than top_m, {top_m:g}"
                )
            case BoxObstacle(min_enu_m=low_m, max_enu_m=high_m):
                for axis, low, high in zip("xyz", low_m, high_m, strict=True):
                    if low >= high:
                        text = f"{axis} is {low:g}, expected less than max_enu_m's {high:g}"
                        yield Problem(f"{where}obstacles[{index}].min_enu_m", text)


def _polygon(fleet: FleetConfig, where: str) -> Iterator[Problem]:
    corners = fleet.envelope.fence_corners_enu_m
    if not len(corners):
        return
    if len(corners) < 3:
        yield Problem(where, f"has {len(corners)} corners; expected at least 3, or none for a box")
    elif crossing := crossing_sides(corners):
        i, j = crossing
        yield Problem(where, f"the sides that begin at corners {i} and {j} touch or cross; expected corners in order")
    elif (size_m2 := area_m2(corners)) < SMALLEST_AREA_M2:
        yield Problem(where, f"has an area of {size_m2:.2f} m^2; expected at least {SMALLEST_AREA_M2:g}")


def path_problems(
    where: str, fleet: FleetConfig, reference: Reference, slots_enu_m: Mapping[int, Vector3], speed_m_s: float
) -> Iterator[Problem | None]:
    """The first vehicle whose path with this reference leaves the fence or meets an obstacle, in an airspace beyond a box.

    `speed_m_s` is the largest speed of the reference. A slot that turns about the RFT needs room on its whole circle. None
    stands for a pause of the check.
    """
    airspace = fleet.airspace
    if airspace.is_box:
        return
    for vehicle_id, slot_enu_m in slots_enu_m.items():
        offset, around_m = ((0.0, 0.0, slot_enu_m[2]), reach_m([slot_enu_m])) if fleet.slots_turn else (slot_enu_m, 0.0)
        steps = _conflict(airspace, reference, offset, around_m, speed_m_s)
        position = yield from coarser(steps, airspace.positions_per_step())
        yield None
        if position is not None:
            x, y, z = position
            place = f"({x:.1f}, {y:.1f}, {z:.1f})" + (f" with {around_m:.1f} m around it to turn" if around_m else "")
            text = f"brings vehicle {vehicle_id} to {place}, too near to {nearest_kind(airspace, position)}"
            clearance = f"expected a path that keeps envelope.clearance_m, {airspace.clearance_m:g} m"
            yield Problem(f"{where}.{FIELD_OF_POSITION[type(reference)]}", f"{text}; {clearance}")
            return


def _conflict(
    airspace: Airspace, reference: Reference, offset: Vector3, around_m: float, speed_m_s: float
) -> Steps[Vector3 | None]:
    if isinstance(reference, WaypointsReference):
        points = [plus(point, offset) for point in reference.points_enu_m]
        legs = pairwise(points) if len(points) > 1 else [(points[0], points[0])]
        for a, b in legs:
            if (found := (yield from leg_conflict_steps(airspace, a, b, around_m))) is not None:
                return found
        return None
    curve = reference.curve()
    lasts_s = reference.ramp_s + reference.period_s if isinstance(reference, Lapping) else 0.0
    at, rate_m_s = lambda time_s: plus(curve(time_s)[0], offset), max(speed_m_s, 0.1)
    return (yield from conflict_steps(airspace, at, lasts_s, rate_m_s, around_m))
