"""Feedback of the mean of all neighbours, with integral action on it."""

from collections.abc import Sequence
from typing import ClassVar

from companion.laws import FormationState, Gain, Law, Memory, Neighbour, Own
from companion.types.values import Vector3


class Integral(Law, frozen=True):
    """position_gain_1_s2, velocity_gain_1_s and integral_gain_1_s3: on the mean error of position, velocity, its integral."""

    position_gain_1_s2: Gain = 2.0
    velocity_gain_1_s: Gain = 2.4
    integral_gain_1_s3: Gain = 0.3
    memory: ClassVar[int] = 1

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        k1, k2, k3 = self.position_gain_1_s2, self.velocity_gain_1_s, self.integral_gain_1_s3
        errors = _errors(own, neighbours, reference)
        x, y, z = [-k1 * p - k2 * v - k3 * m for p, v, m in zip(*errors, own.memory[0], strict=True)]
        return (x, y, z)

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:
        positions, _ = _errors(own, neighbours, reference)
        x, y, z = [m + own.step_s * p for p, m in zip(positions, own.memory[0], strict=True)]
        return ((x, y, z),)


def _errors(own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> tuple[Vector3, Vector3]:
    """Of position and velocity against the reference, or for a follower against the mean of those nearer to the leader."""
    least = min((neighbour.prc for neighbour in neighbours), default=0)
    others = [reference] if reference else [neighbour for neighbour in neighbours if neighbour.prc == least]
    p, v = [0.0] * 3, [0.0] * 3
    for other in others:
        for axis in range(3):
            p[axis] += (own.position_enu_m[axis] - other.position_enu_m[axis]) / len(others)
            v[axis] += (own.velocity_enu_m_s[axis] - other.velocity_enu_m_s[axis]) / len(others)
    return (p[0], p[1], p[2]), (v[0], v[1], v[2])
