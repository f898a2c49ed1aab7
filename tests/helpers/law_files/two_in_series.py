"""Two first-order consensus laws in series: s = v + a L y is published, and u = -a L v - b L s."""

from collections.abc import Sequence
from typing import ClassVar

from companion.laws import FormationState, Gain, Law, Neighbour, Own, Values
from companion.types.values import Vector3


class TwoInSeries(Law, frozen=True):
    """a, b: gains of the two, 1/s."""

    a: Gain = 1.0
    b: Gain = 2.0
    publishes: ClassVar[int] = 1

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        s, u = self.publish(own, neighbours, reference)[0], [0.0, 0.0, 0.0]
        pairs: list[tuple[float, Vector3, Vector3]] = [
            (w, n.velocity_enu_m_s, n.values[0]) for w, n in _weighed(neighbours) if reference is None
        ]
        if reference:
            pairs = [(1.0, reference.velocity_enu_m_s, reference.velocity_enu_m_s)]
        for weight, velocity, other in pairs:
            for axis in range(3):
                u[axis] -= weight * self.a * (own.velocity_enu_m_s[axis] - velocity[axis])
                u[axis] -= weight * self.b * (s[axis] - other[axis])
        return (u[0], u[1], u[2])

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        s = list(own.velocity_enu_m_s)
        around: list[tuple[float, FormationState]] = [(1.0, reference)] if reference else [*_weighed(neighbours)]
        for weight, other in around:
            for axis in range(3):
                s[axis] += weight * self.a * (own.position_enu_m[axis] - other.position_enu_m[axis])
        return ((s[0], s[1], s[2]),)


def _weighed(neighbours: Sequence[Neighbour]) -> list[tuple[float, Neighbour]]:
    """Half of the neighbours' mean, and half of those nearer to the leader: cycles, and a way from the leader."""
    least = min((neighbour.prc for neighbour in neighbours), default=0)
    near = sum(neighbour.prc == least for neighbour in neighbours)
    return [(0.5 / len(neighbours) + 0.5 * (n.prc == least) / near, n) for n in neighbours]
