"""Turning right where two vehicles block each other, as the rules of the air demand of aircraft that meet head-on."""

from __future__ import annotations

from collections.abc import Iterable
from math import hypot

from companion.core.consensus.law import Gains
from companion.core.safety.filter.separation import Barrier
from companion.types.values import Vector3

TURN = 0.8  # sideways acceleration for each m/s^2 that a half-space takes from the wanted one
LARGEST_TURN_M_S2 = 2.0  # towards the right of all blocking vehicles together
PASSING_M_S = 1.0  # a vehicle this fast does not stay on the goal
DRIFTING_M_S = 0.2  # sideways, from which on a vehicle that does not make way is passed on its other side
OCCUPIED = 1.0  # a goal nearer to the blocking vehicle than this share of the required distance cannot be reached


def turn_right(
    wanted_enu_m_s2: Vector3, velocity_enu_m_s: Vector3, gains: Gains, barriers: Iterable[Barrier]
) -> tuple[float, float]:
    """Horizontal acceleration to add (east, north), m/s^2: to the right of the vehicles that block the way.

    Two vehicles that meet head-on turn about each other, more than two about their centre. A vehicle that does not make way,
    such as one in hold on the goal, is not circled: the wanted acceleration u is that of a goal (u + k2 v)/k1 away.
    """
    (x, y, z), (vx, vy, _) = wanted_enu_m_s2, velocity_enu_m_s
    right_x = right_y = 0.0
    for barrier in barriers:
        nx, ny, nz, least, _ = barrier.space
        along = nx * x + ny * y + nz * z
        taken = (least if least < 0.0 else 0.0) - along  # of what is wanted towards the other vehicle
        if taken <= 0.0:
            continue
        if barrier.other.slot is None:
            k1, k2 = gains.position_1_s2, gains.velocity_1_s
            rx, ry, _ = barrier.offset_enu_m
            other_x, other_y, _ = barrier.other.velocity_enu_m_s
            goal_m = hypot((x + k2 * vx) / k1 + rx, (y + k2 * vy) / k1 + ry)
            leaves = hypot(other_x, other_y) / PASSING_M_S
            taken *= min(max(2.0 * (goal_m / barrier.required_m - OCCUPIED), leaves, 0.0), 1.0)
            if (vy - other_y) * nx - (vx - other_x) * ny < -DRIFTING_M_S:  # already passing on the other side
                taken = -taken
        right_x, right_y = right_x - TURN * taken * ny, right_y + TURN * taken * nx
    size = hypot(right_x, right_y)
    scale = LARGEST_TURN_M_S2 / size if size > LARGEST_TURN_M_S2 else 1.0
    return (right_x * scale, right_y * scale)
