"""Reference formation trajectories (RFT): time -> R = [r, r'] and r''. Held only by vehicles that may become leader."""

from __future__ import annotations

from collections.abc import Callable

from companion.core.consensus.law import FormationState
from companion.geometry.curves import Curve
from companion.types.values import ZERO3, Vector3

ReferenceTrajectory = Callable[[float], FormationState]
"""Seconds since the start of the RFT -> R and r''. The RFT starts when the leader enters formation."""


def point(position_enu_m: Vector3) -> ReferenceTrajectory:
    """RFT at a fixed point: r' = r'' = 0."""
    at_rest = FormationState(position_enu_m, ZERO3)
    return lambda _reference_s: at_rest


def along(curve: Curve) -> ReferenceTrajectory:
    """RFT along a curve."""
    return lambda reference_s: FormationState(*curve(reference_s))
