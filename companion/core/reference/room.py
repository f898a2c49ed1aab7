"""Room of an RFT whose way is not known in advance: the walls that none of its slots may cross, and braking before them.

Braking goes straight along the velocity. Each wall is a plane, a side of the fence's polygon or a convex obstacle, so
it lies behind the plane across its nearest point, and braking that ends before that plane stays clear of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot

from companion.core.reference.approach import APPROACH, PULL_1_S, approach_speed
from companion.geometry.airspace import Airspace, Gap
from companion.geometry.vectors import dot, plus, scaled
from companion.types.values import Vector3

Box = tuple[Vector3, Vector3]
"""Lowest and highest coordinates, m."""

AXES: tuple[Vector3, Vector3, Vector3] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
STEP_S = 0.05  # longest step of a pursuit
SHARE = 0.8  # of the way to a wall that braking may need
PASSES = 3  # a velocity kept from one wall may lead to another one


@dataclass(frozen=True, slots=True)
class Room:
    """Room for r. `box` is that of r itself, `airspace` that of each slot about r, None where the box is all there is."""

    box: Box
    airspace: Airspace | None = None
    slots_enu_m: tuple[Vector3, ...] = ()
    around_m: float = 0.0  # further room about each slot

    def gaps(self, position_enu_m: Vector3, within_m: float) -> list[Gap]:
        """Room of r and of the slots about it to all walls that are nearer than this."""
        found: list[Gap] = []
        for axis, (p, low, high) in enumerate(zip(position_enu_m, *self.box, strict=True)):
            if p - low < within_m:
                found.append((p - low, AXES[axis]))
            if high - p < within_m:
                found.append((high - p, scaled(AXES[axis], -1.0)))
        if self.airspace is None:
            return found
        kept_m = self.airspace.clearance_m + self.around_m
        for slot in self.slots_enu_m:
            walls = self.airspace.walls(plus(position_enu_m, slot), within_m + kept_m)
            found += [(distance_m - kept_m, normal) for distance_m, normal in walls]
        return found

    def can_stop(self, position_enu_m: Vector3, velocity_enu_m_s: Vector3, braking_m_s2: float) -> bool:
        """Whether braking stops before all walls. Half a step is added: the step that stops does not only brake."""
        speed_m_s = hypot(*velocity_enu_m_s)
        lasts_s = speed_m_s / (2.0 * braking_m_s2) + STEP_S / 2.0
        for distance_m, normal in self.gaps(position_enu_m, speed_m_s * lasts_s):
            approach_m_s = -dot(normal, velocity_enu_m_s)
            if approach_m_s > 0.0 and distance_m < approach_m_s * lasts_s:
                return False
        return True

    def kept_away(self, wanted: Vector3, position: Vector3, velocity: Vector3, braking_m_s2: float) -> Vector3:
        """The wanted velocity, without what would approach a wall too fast to brake gently from `velocity`."""
        fastest_m_s, speed_m_s = hypot(*wanted), hypot(*velocity)
        per_room_1_s = min(PULL_1_S, SHARE * braking_m_s2 / max(speed_m_s, STEP_S * braking_m_s2))
        gaps = self.gaps(position, fastest_m_s / per_room_1_s + fastest_m_s**2 / braking_m_s2)
        for _ in range(PASSES):
            for distance_m, normal in gaps:
                gently_m_s = approach_speed(distance_m, APPROACH * braking_m_s2)
                allowed_m_s = min(gently_m_s, max(0.0, per_room_1_s * distance_m))
                if (excess_m_s := -dot(normal, wanted) - allowed_m_s) > 0.0:
                    wanted = plus(wanted, scaled(normal, excess_m_s))
        return wanted
