"""Where a silent vehicle may be: it keeps its attitude at first, and is then anywhere on the way that it can coast.

An autopilot without setpoints keeps the last attitude for about 1 s (PX4 COM_OF_LOSS_T, ArduCopter GUID_TIMEOUT). PX4 then
brakes to a hold; ArduCopter levels, and only drag slows it down. No other vehicle knows which of these a silent one does, so
all of the way counts, and it grows with the time of silence. Heights are held by both.
"""

from __future__ import annotations

from math import exp

from companion.types.vectors import Vector3

COAST_1_S = 0.25  # decay of the speed of a level multirotor: less than that of most airframes


def with_kept_attitude(position_enu_m: Vector3, acceleration_enu_m_s2: Vector3, kept_s: float) -> Vector3:
    """The position moved by what a horizontal acceleration adds in this time."""
    (x, y, z), (ax, ay, _) = position_enu_m, acceleration_enu_m_s2
    added_s2 = 0.5 * kept_s * kept_s
    return (x + added_s2 * ax, y + added_s2 * ay, z)


def velocity_after(velocity_enu_m_s: Vector3, acceleration_enu_m_s2: Vector3, kept_s: float) -> Vector3:
    """The horizontal velocity after this time; the height is held."""
    (vx, vy, _), (ax, ay, _) = velocity_enu_m_s, acceleration_enu_m_s2
    return (vx + kept_s * ax, vy + kept_s * ay, 0.0)


def nearest_on_way(
    own_enu_m: Vector3, from_enu_m: Vector3, velocity_enu_m_s: Vector3, coasts_s: float
) -> tuple[Vector3, Vector3]:
    """(position, velocity) of the point nearest to this vehicle on the way of one that has coasted for so long.

    `from_enu_m` and the level `velocity_enu_m_s` are those at the beginning. A point within moves as the way grows.
    """
    (x, y, _), (px, py, pz), (vx, vy, _) = own_enu_m, from_enu_m, velocity_enu_m_s
    speed_left = exp(-COAST_1_S * coasts_s)
    reach_s = (1.0 - speed_left) / COAST_1_S
    dx, dy = reach_s * vx, reach_s * vy
    length2_m2 = dx * dx + dy * dy
    share = ((x - px) * dx + (y - py) * dy) / length2_m2 if length2_m2 > 0.0 else 0.0
    share = min(max(share, 0.0), 1.0)
    moving = share * speed_left
    return (px + share * dx, py + share * dy, pz), (moving * vx, moving * vy, 0.0)
