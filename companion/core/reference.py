"""Reference formation trajectories (RFT): time -> R = [r, r'] and r''. Only vehicles that may lead hold one."""

from __future__ import annotations

from collections.abc import Callable

from companion.core.formation import Place
from companion.geometry.curves import Curve
from companion.types import ZERO3, Vector3

ReferenceTrajectory = Callable[[float], Place]
"""Takes the seconds into the RFT, which begin when the leader enters formation."""


def point(position_enu_m: Vector3) -> ReferenceTrajectory:
    """r stands still, r' = r'' = 0."""
    standing = Place(position_enu_m, ZERO3)
    return lambda _reference_s: standing


def along(curve: Curve) -> ReferenceTrajectory:
    """r goes as the curve does."""
    return lambda reference_s: Place(*curve(reference_s))
