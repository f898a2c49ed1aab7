"""Integral action behind the neighbours nearest to the leader: in steady wind a vehicle comes to its slot all the same."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

from msgspec import Meta

from companion.laws import FormationState, Gain, Law, Memory, Neighbour, Own
from companion.types.values import Vector3


class Integral(Law, frozen=True):
    """u_i = -k1 e_i - k2 e'_i - k0 s_i; e_i: mean of x_i - x_j over neighbours with the least PrC; s_i: its integral.

    position_gain_1_s2: k1
    velocity_gain_1_s: k2; k0, integral_gain_1_s3, must be below k1 k2
    """

    memory = 1  # s_i
    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4
    integral_gain_1_s3: Annotated[float, Meta(ge=0, le=1)] = 0.2

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        k1, k2, k0 = self.position_gain_1_s2, self.velocity_gain_1_s, self.integral_gain_1_s3
        e = self._errors("position_enu_m", own, neighbours, reference)
        v = self._errors("velocity_enu_m_s", own, neighbours, reference)
        return tuple(-k1 * e[k] - k2 * v[k] - k0 * own.memory[0][k] for k in range(3))  # type: ignore[return-value]

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        e = self._errors("position_enu_m", own, neighbours, reference)  # it ends at 20 m s on each axis
        return (tuple(max(-20.0, min(own.memory[0][k] + own.step_s * e[k], 20.0)) for k in range(3)),)  # type: ignore[return-value]

    def _errors(self, of: str, own: Own, near: Sequence[Neighbour], reference: FormationState | None) -> list[float]:
        least = min((other.prc for other in near), default=1)
        nearest = [other for other in near if other.prc == least]
        states: Sequence[FormationState] = [reference] if reference else nearest or [own]
        return [getattr(own, of)[k] - sum(getattr(other, of)[k] for other in states) / len(states) for k in range(3)]
