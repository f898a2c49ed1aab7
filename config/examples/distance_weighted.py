"""Neighbours count by how near they are: w_ij is proportional to 1 / (r_0 + distance)."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist
from typing import Annotated

from msgspec import Meta

from companion.laws import FormationState, Gain, Law, Neighbour, Own
from companion.types.values import Vector3


class DistanceWeighted(Law, frozen=True):
    """u_i = -sum_j w_ij (k1 (x_i - x_j) + k2 (x'_i - x'_j)), and the reference with the weight 1.

    position_gain_1_s2: k1, on the position error
    velocity_gain_1_s: k2, on the velocity error
    near_m: r_0, the distance that is added: at 0 m the weight stays finite
    """

    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4
    near_m: Annotated[float, Meta(ge=0.1, le=100)] = 1.0

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """Slots are part of the distance: a neighbour two slots away counts less."""
        shares = [1.0 / (self.near_m + dist(own.slot_enu_m, other.slot_enu_m)) for other in neighbours]
        pulls: list[tuple[float, FormationState]]
        pulls = [(share / sum(shares), other) for share, other in zip(shares, neighbours, strict=True)]
        pulls += [(1.0, reference)] if reference is not None else []
        x, y, z = (sum(weight * self._pull(own, other, axis) for weight, other in pulls) for axis in range(3))
        return (x, y, z)

    def _pull(self, own: Own, other: FormationState, axis: int) -> float:
        error_m = own.position_enu_m[axis] - other.position_enu_m[axis]
        return -self.position_gain_1_s2 * error_m - self.velocity_gain_1_s * (
            own.velocity_enu_m_s[axis] - other.velocity_enu_m_s[axis]
        )
