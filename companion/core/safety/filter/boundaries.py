"""Half-spaces of the own acceleration that stop the vehicle before the fence and before static obstacles.

A control barrier function of a double integrator (Ames et al., "Control Barrier Functions: Theory and Applications", ECC 2019)
for each wall and obstacle: with the room h and its rate h', b = h' + V(h) >= 0 means that the vehicle can still stop, where V
is the approach speed of `geometry/curves.py`. b' >= -k b is linear in the acceleration. It is evaluated for the state that the
attitude lag leads to (`lag.py`). Distances to convex bodies are convex in time, so moving past one only adds room.
"""

from __future__ import annotations

from math import sqrt

from companion.core.safety.filter.acceleration_filter import HalfSpace, Rank
from companion.core.safety.filter.lag import Ahead
from companion.geometry.airspace import Airspace, Gap
from companion.geometry.curves import approach_speed

OBSTACLE, FENCE = Rank.OBSTACLE, Rank.FENCE
BOUNDARY_RESPONSE_1_S = 4.0  # k: how fast b may approach 0
SLOPE_1_S = 2.0  # of the approach speed near the boundary
FASTEST_RETURN_M_S = 1.0  # demanded beyond the boundary
NEVER_WANTED_M_S2 = 20.0  # no acceleration is larger, so a half-space that allows all up to this cannot matter


class Boundaries:
    """`level_m_s2` and `vertical_m_s2` are the decelerations that the vehicle plans to brake with."""

    def __init__(self, airspace: Airspace, level_m_s2: float, vertical_m_s2: float) -> None:
        self._airspace = airspace
        self._level_m_s2 = level_m_s2
        self._vertical_m_s2 = vertical_m_s2
        self._least_m_s2 = min(level_m_s2, vertical_m_s2)
        self._reach_at_rest_m = airspace.clearance_m + self._least_m_s2 / SLOPE_1_S**2

    def half_spaces(self, ahead: Ahead) -> list[HalfSpace]:
        """Half-spaces of all obstacles and walls of the fence that may matter in this state."""
        position_enu_m, reach_m = ahead.position_enu_m, self._reach_m(ahead)
        spaces = []
        for obstacle in self._airspace.obstacles:
            gap = obstacle.gap(position_enu_m)
            if gap[0] < reach_m:
                spaces.append(self._half_space(gap, ahead, OBSTACLE))
        walls = self._airspace.fence.gaps(position_enu_m, reach_m)
        return spaces + [self._half_space(gap, ahead, FENCE) for gap in walls] if walls else spaces

    def _reach_m(self, ahead: Ahead) -> float:
        """Farther than this nothing limits an acceleration: V(h) is above the speed by NEVER_WANTED_M_S2 / k."""
        vx, vy, vz = ahead.velocity_enu_m_s
        speed_m_s = sqrt(vx * vx + vy * vy + vz * vz) + NEVER_WANTED_M_S2 / BOUNDARY_RESPONSE_1_S
        return self._reach_at_rest_m + speed_m_s * speed_m_s / (2.0 * self._least_m_s2)

    def _half_space(self, gap: Gap, ahead: Ahead, rank: Rank) -> HalfSpace:
        distance_m, (nx, ny, nz) = gap
        vx, vy, vz = ahead.velocity_enu_m_s
        rate_m_s = nx * vx + ny * vy + nz * vz
        speed_m_s, slope_1_s = approach_speed(
            distance_m - self._airspace.clearance_m, self._braking_m_s2(nz), SLOPE_1_S
        )
        if speed_m_s < -FASTEST_RETURN_M_S:
            speed_m_s, slope_1_s = -FASTEST_RETURN_M_S, 0.0
        least = -BOUNDARY_RESPONSE_1_S * (rate_m_s + speed_m_s) - slope_1_s * rate_m_s
        return (nx, ny, nz, least, rank)

    def _braking_m_s2(self, upward: float) -> float:
        if upward == 0.0:
            return self._level_m_s2
        return self._vertical_m_s2 if abs(upward) == 1.0 else self._least_m_s2
