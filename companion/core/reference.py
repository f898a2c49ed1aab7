"""Reference formation trajectories (RFT): time -> R = [r, r'] and r''. Only vehicles that may lead hold one."""

from __future__ import annotations

from collections.abc import Callable

from companion import curves
from companion.core.formation import Place
from companion.types import ZERO3, Vector3

ReferenceTrajectory = Callable[[float], Place]
"""Takes the seconds into the RFT, which begin when the leader enters formation."""


def point(position_enu_m: Vector3) -> ReferenceTrajectory:
    """r stands still, r' = r'' = 0."""
    standing = Place(position_enu_m, ZERO3)
    return lambda _reference_s: standing


def figure_8(
    centre_enu_m: Vector3, width_m: float, height_m: float, period_s: float, ramp_s: float
) -> ReferenceTrajectory:
    """A level 8 that lies along x: it leaves its centre with zero speed and runs a lap in `period_s` after `ramp_s`."""
    cx, cy, cz = centre_enu_m

    def trajectory(reference_s: float) -> Place:
        (x, y, z), velocity, acceleration = curves.figure_8(reference_s, width_m, height_m, period_s, ramp_s)
        return Place((cx + x, cy + y, cz + z), velocity, acceleration)

    return trajectory
