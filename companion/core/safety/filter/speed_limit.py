"""Largest horizontal and vertical speed of a vehicle: limits of the acceleration along the velocity.

As in PX4's `PositionControl`, velocity is limited before acceleration, and acceleration before tilt and thrust. Here the law
gives an acceleration, so the limit is u . v/|v| <= k (most - |v|): the speed approaches the limit and does not exceed it. It is
evaluated for the velocity that the attitude lag leads to (`lag.py`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import hypot

from companion.core.safety.filter.acceleration_filter import HalfSpace, Rank
from companion.core.safety.filter.lag import Ahead
from companion.types.values import Vector3

SPEED = Rank.SPEED
SPEED_RESPONSE_1_S = 2.0  # k
STILL_M_S = 0.1  # below this speed its direction means nothing


@dataclass(frozen=True, slots=True)
class SpeedLimit:
    """Largest speeds: horizontal, upwards and downwards."""

    level_m_s: float
    climb_m_s: float
    descent_m_s: float

    def half_spaces(self, ahead: Ahead) -> list[HalfSpace]:
        """Half-spaces of the vertical and of the horizontal speed. Their normals are perpendicular to each other."""
        vx, vy, vz = ahead.velocity_enu_m_s
        if vz > 0.0:
            spaces: list[HalfSpace] = [(0.0, 0.0, -1.0, -SPEED_RESPONSE_1_S * (self.climb_m_s - vz), SPEED)]
        else:
            spaces = [(0.0, 0.0, 1.0, -SPEED_RESPONSE_1_S * (self.descent_m_s + vz), SPEED)]
        level_m_s = hypot(vx, vy)
        if level_m_s > STILL_M_S:
            least_m_s2 = -SPEED_RESPONSE_1_S * (self.level_m_s - level_m_s)
            spaces.append((-vx / level_m_s, -vy / level_m_s, 0.0, least_m_s2, SPEED))
        return spaces


def limited(acceleration_enu_m_s2: Vector3, spaces: Iterable[HalfSpace]) -> Vector3:
    """The acceleration without what would exceed a speed limit; the same object where there is nothing of it."""
    allowed = acceleration_enu_m_s2
    for space in spaces:
        (nx, ny, nz, least, _), (ux, uy, uz) = space, allowed
        short = least - (nx * ux + ny * uy + nz * uz)
        if short > 0.0:
            allowed = (ux + short * nx, uy + short * ny, uz + short * nz)
    return allowed
