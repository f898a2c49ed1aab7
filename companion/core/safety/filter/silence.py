"""Where a silent vehicle may be: between where it brakes at once and where it keeps its attitude, then coasts.

An agent that fails levels and requests a hold before it falls silent. An autopilot without setpoints keeps the last attitude
for about 1 s (PX4 COM_OF_LOSS_T, ArduCopter GUID_TIMEOUT). PX4 then brakes to a hold or lands (COM_OBL_RC_ACT); ArduCopter
levels, and only drag slows it down. No other vehicle knows which of these a silent one does, so all of the way counts.
"""

from __future__ import annotations

from math import exp, hypot, inf, sqrt

from msgspec import Struct

from companion.core.safety.filter.lag import Ahead
from companion.geometry.vectors import shortened
from companion.types.values import ZERO3, Vector3

KEPT_S = 1.0  # an autopilot without setpoints keeps its attitude for so long
COAST_1_S = 0.25  # decay of the speed of a level multirotor: less than that of most airframes
GROWS_S = 0.4  # from the expected position to the whole way
DESCENT_M_S = 1.5  # of an autopilot that lands
LANDS_S = 0.6  # PX4's smallest COM_OF_LOSS_T
COLUMN_M_S = 1.0  # growth of the distance that a vehicle below keeps

Motion = tuple[Vector3, Vector3, Vector3]
"""Position, velocity and acceleration."""


class Silence(Struct, frozen=True, gc=False):
    """From which age of its last state on a vehicle counts as silent, and how it may fly then.

    It brakes after `brakes_s` at the earliest, and keeps its attitude until `kept_s`. It flies `most_m_s` at most: one
    packet may report any velocity. `lands`: it may do so.
    """

    begins_s: float
    brakes_s: float
    kept_s: float
    most_m_s: float = inf
    lands: bool = True


def nearest_on_way(
    own: Ahead, last: Motion, age_s: float, ahead_s: float, silence: Silence, braking_m_s2: float, weight: float
) -> Motion:
    """The point nearest to this vehicle of all where a silent one may be `ahead_s` from now, and how that point moves.

    `last` is `age_s` old. The way is a straight line from where the vehicle brakes at once to where it coasts. It grows from
    the expected position within GROWS_S, so nothing jumps. Between its ends the point follows this vehicle along the way.
    `weight` is that of heights.
    """
    at_s, most_m_s = age_s + ahead_s, silence.most_m_s
    plausible = (last[0], shortened(last[1], most_m_s), last[2])
    braked = _braking(plausible, at_s, silence.brakes_s, braking_m_s2)
    coasted = _coasting(plausible, at_s, silence.kept_s, most_m_s)
    part = (age_s - silence.begins_s) / GROWS_S
    if part < 1.0:
        expected = _expected(last, at_s)
        braked, coasted = _grown(expected, braked, part), _grown(expected, coasted, part)
    (x, y, z), (px, py, pz), (qx, qy, qz) = own.position_enu_m, braked[0], coasted[0]
    dx, dy, dz = qx - px, qy - py, (qz - pz) * weight
    length2_m2 = dx * dx + dy * dy + dz * dz
    share = ((x - px) * dx + (y - py) * dy + (z - pz) * weight * dz) / length2_m2 if length2_m2 > 0.0 else 0.0
    if share <= 0.0:
        return braked
    if share >= 1.0:
        return coasted
    position_enu_m, (vx, vy, vz), acceleration_enu_m_s2 = _between(braked, coasted, share)
    wx, wy, wz = own.velocity_enu_m_s
    follows_1_s = ((wx - vx) * dx + (wy - vy) * dy + (wz - vz) * weight * dz) / length2_m2
    vx, vy, vz = vx + follows_1_s * (qx - px), vy + follows_1_s * (qy - py), vz + follows_1_s * (qz - pz)
    return position_enu_m, (vx, vy, vz), acceleration_enu_m_s2


def column_m(required_m: float, above_m: float, silent_s: float, weight: float) -> tuple[float, float]:
    """(horizontal distance to keep below a vehicle that may land, its growth in m/s).

    It has been silent for `silent_s` longer than an autopilot keeps its attitude, and was last `above_m` above this one. It
    may be at any height that a landing reaches by now.
    """
    growing_m = COLUMN_M_S * silent_s
    left_m = above_m - DESCENT_M_S * (silent_s + KEPT_S - LANDS_S)
    below_m, below_m_s = (required_m - left_m * weight, DESCENT_M_S * weight) if left_m > 0.0 else (required_m, 0.0)
    return (growing_m, COLUMN_M_S) if growing_m < below_m else (below_m, below_m_s)


def _expected(last: Motion, at_s: float) -> Motion:
    """As a fresh vehicle is extrapolated."""
    (x, y, z), (vx, vy, vz), (ax, ay, az) = last
    there_enu_m = (x + vx * at_s, y + vy * at_s, z + vz * at_s)
    return there_enu_m, (vx + ax * at_s, vy + ay * at_s, vz + az * at_s), last[2]


def _braking(last: Motion, at_s: float, brakes_s: float, braking_m_s2: float) -> Motion:
    """Straight on, then braking to a stop."""
    (x, y, z), (vx, vy, vz), _ = last
    speed_m_s = sqrt(vx * vx + vy * vy + vz * vz)
    if speed_m_s == 0.0:
        return last[0], ZERO3, ZERO3
    stop_s, braking_s = speed_m_s / braking_m_s2, at_s - brakes_s
    stopped = braking_s >= stop_s
    if stopped:
        braking_s = stop_s
    # Times at the first velocity, and shares of it.
    gone_s = brakes_s + braking_s - 0.5 * braking_s * braking_s / stop_s
    left = 0.0 if stopped else 1.0 - braking_s / stop_s
    slows_1_s = 0.0 if stopped else -1.0 / stop_s
    return (
        (x + gone_s * vx, y + gone_s * vy, z + gone_s * vz),
        (left * vx, left * vy, left * vz),
        (slows_1_s * vx, slows_1_s * vy, slows_1_s * vz),
    )


def _coasting(last: Motion, at_s: float, kept_s: float, most_m_s: float) -> Motion:
    """The attitude is kept, then level; heights are held then."""
    (x, y, z), (vx, vy, vz), (ax, ay, _) = last
    keeps_s = min(at_s, kept_s)
    added_s2 = 0.5 * keeps_s * keeps_s
    there_enu_m = (x + keeps_s * vx + added_s2 * ax, y + keeps_s * vy + added_s2 * ay, z + keeps_s * vz)
    vx, vy = vx + keeps_s * ax, vy + keeps_s * ay
    if at_s <= kept_s:
        return there_enu_m, (vx, vy, vz), (ax, ay, 0.0)
    speed_m_s = hypot(vx, vy)
    if speed_m_s > most_m_s:
        vx, vy = vx * most_m_s / speed_m_s, vy * most_m_s / speed_m_s
    left = exp(-COAST_1_S * (at_s - kept_s))
    reach_s = (1.0 - left) / COAST_1_S
    x, y, z = there_enu_m
    slows_1_s = -COAST_1_S * left
    return (x + reach_s * vx, y + reach_s * vy, z), (left * vx, left * vy, 0.0), (slows_1_s * vx, slows_1_s * vy, 0.0)


def _grown(expected: Motion, end: Motion, part: float) -> Motion:
    """From the expected motion to an end of the way, smoothly."""
    share, rate_1_s = part * part * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / GROWS_S
    position_enu_m, (vx, vy, vz), acceleration_enu_m_s2 = _between(expected, end, share)
    (px, py, pz), (qx, qy, qz) = expected[0], end[0]
    moving = (vx + rate_1_s * (qx - px), vy + rate_1_s * (qy - py), vz + rate_1_s * (qz - pz))
    return position_enu_m, moving, acceleration_enu_m_s2


def _between(one: Motion, other: Motion, share: float) -> Motion:
    ((ax, ay, az), (bx, by, bz), (cx, cy, cz)), ((dx, dy, dz), (ex, ey, ez), (fx, fy, fz)) = one, other
    return (
        (ax + share * (dx - ax), ay + share * (dy - ay), az + share * (dz - az)),
        (bx + share * (ex - bx), by + share * (ey - by), bz + share * (ez - bz)),
        (cx + share * (fx - cx), cy + share * (fy - cy), cz + share * (fz - cz)),
    )
