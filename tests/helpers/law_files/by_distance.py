"""A nearer neighbour counts more: weights 1/(0.5 m + d) of the distances as they are."""

from collections.abc import Sequence
from math import dist

from companion.laws import FormationState, Gain, Law, Neighbour, Own
from companion.types.values import Vector3


class ByDistance(Law, frozen=True):
    """k1 on position, k2 on velocity."""

    k1: Gain = 1.5
    k2: Gain = 2.0

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        here = _place(own)
        shares = [1.0 / (0.5 + dist(here, _place(neighbour))) for neighbour in neighbours]
        weighed: list[tuple[float, FormationState]] = list(zip(shares, neighbours, strict=True))
        total = sum(shares)
        pairs = [(share / total, state) for share, state in weighed] + ([(1.0, reference)] if reference else [])
        u = [0.0, 0.0, 0.0]
        for share, other in pairs:
            for axis in range(3):
                u[axis] -= share * self.k1 * (own.position_enu_m[axis] - other.position_enu_m[axis])
                u[axis] -= share * self.k2 * (own.velocity_enu_m_s[axis] - other.velocity_enu_m_s[axis])
        return (u[0], u[1], u[2])


def _place(state: Own | Neighbour) -> Vector3:
    (x, y, z), (dx, dy, dz) = state.position_enu_m, state.slot_enu_m
    return (x + dx, y + dy, z + dz)
