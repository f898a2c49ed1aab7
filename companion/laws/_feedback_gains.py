"""Gains of any law about the formation: how hard a follower is pulled to its only neighbour."""

from __future__ import annotations

from companion.laws import Law, Neighbour, Own
from companion.types.formation import Gains
from companion.types.values import ZERO3

STEP = 1.0  # m and m/s: exact where a law is linear


def feedback_gains(law: Law) -> Gains:
    """K = [k1, k2] of a law, as the difference of its acceleration over 1 m and 1 m/s. Raises whatever the law raises.

    The separation filter and the paths into formation count on these. Those of the built-in laws are their parameters.
    """
    memory, ahead = (ZERO3,) * law.memory, Neighbour(ZERO3, ZERO3, values=(ZERO3,) * law.publishes)

    def x_acceleration(position_m: float, velocity_m_s: float) -> float:
        own = Own((position_m, 0.0, 0.0), (velocity_m_s, 0.0, 0.0), memory=memory)
        return law.acceleration(own, (ahead,), None)[0]

    at_rest = x_acceleration(0.0, 0.0)
    return Gains(at_rest - x_acceleration(STEP, 0.0), at_rest - x_acceleration(0.0, STEP))
