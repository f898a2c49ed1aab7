"""Reference formation trajectories (RFT): time -> R = [r, r']. Only leaders hold one."""

from __future__ import annotations

from collections.abc import Callable

from companion.core.formation import Place
from companion.types import ZERO3, Vector3

ReferenceTrajectory = Callable[[float], Place]


def point(position_enu_m: Vector3) -> ReferenceTrajectory:
    """r stands still, r' = 0. The trajectory takes the seconds since this vehicle entered formation."""
    standing = Place(position_enu_m, ZERO3)
    return lambda _formation_s: standing
