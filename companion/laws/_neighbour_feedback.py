"""The common form of the paper's laws and of `cooperative`: feedback of weighted differences, and fed-forward acceleration.

The laws are this form with different data. With d_ij = d_i0 - d_j0 every relative error of the paper is a difference of two
formation states: x_i - x_j - d_ij = (x_i - d_i0) - (x_j - d_j0).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from companion.laws import FormationState, Gain, Law, Neighbour, Own, batch_weights, neighbour_weights
from companion.types.formation import Gains
from companion.types.values import Vector3


class NeighbourFeedback(Law, frozen=True):
    """u_i = -K z_i of eq. 14, plus the feed-forward.

    position_gain_1_s2: k1 of K = [k1, k2], on the position error
    velocity_gain_1_s: k2 of K = [k1, k2], on the velocity error
    """

    weighs: ClassVar[bool] = True
    position_gain_1_s2: Gain = 1.39
    velocity_gain_1_s: Gain = 1.2

    @property
    def gains(self) -> Gains:
        """K."""
        return Gains(self.position_gain_1_s2, self.velocity_gain_1_s)

    @property
    def exponent(self) -> float:
        """Alpha of the weights rho^p / p^alpha."""
        return 0.0

    @property
    def weight_ratio(self) -> float:
        """Rho of the weights rho^p / p^alpha."""
        return 1.0

    @property
    def feedforward(self) -> float:
        """G: a follower adds g sum_j w_ij u_j, a leader g (r'' + c r') with its drag c.

        u_j is the last acceleration command of neighbour j, with what it does against its own neighbours. Followers may be
        neighbours of each other, so the sum feeds back; g < 1 keeps it finite.
        """
        return 0.0

    @property
    def leader_uses_neighbours(self) -> bool:
        """False: a leader tracks the RFT alone."""
        return True

    def weights(self, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:
        """Empty for a leader that tracks the RFT alone."""
        if leads and not self.leader_uses_neighbours:
            return ()
        try:
            return neighbour_weights(tuple(prcs), self.exponent, self.weight_ratio)
        except TypeError:  # arrays have no hash
            return batch_weights(prcs, self.exponent, self.weight_ratio)

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """-K z_i of eq. 11 without the offsets, w_ij is 1 for the reference, and the feed-forward; zero without neighbours."""
        weights = self.weights(reference is not None, [neighbour.prc for neighbour in neighbours])
        (x, y, z), (vx, vy, vz) = own.position_enu_m, own.velocity_enu_m_s
        ex = ey = ez = evx = evy = evz = ax = ay = az = 0.0
        for weight, other in zip(weights, neighbours, strict=False):  # no weights: no neighbour counts
            (tx, ty, tz), (tvx, tvy, tvz) = other.position_enu_m, other.velocity_enu_m_s
            tax, tay, taz = other.acceleration_enu_m_s2
            ex, ey, ez = ex + weight * (x - tx), ey + weight * (y - ty), ez + weight * (z - tz)
            evx, evy, evz = evx + weight * (vx - tvx), evy + weight * (vy - tvy), evz + weight * (vz - tvz)
            ax, ay, az = ax + weight * tax, ay + weight * tay, az + weight * taz
        if reference is not None:
            (rx, ry, rz), (rvx, rvy, rvz) = reference.position_enu_m, reference.velocity_enu_m_s
            ex, ey, ez = ex + (x - rx), ey + (y - ry), ez + (z - rz)
            evx, evy, evz = evx + (vx - rvx), evy + (vy - rvy), evz + (vz - rvz)
            (ax, ay, az), c = reference.acceleration_enu_m_s2, own.drag_1_s  # what keeps it on the reference
            ax, ay, az = ax + c * rvx, ay + c * rvy, az + c * rvz
        k1, k2, g = self.position_gain_1_s2, self.velocity_gain_1_s, self.feedforward
        ux, uy, uz = -k1 * ex - k2 * evx, -k1 * ey - k2 * evy, -k1 * ez - k2 * evz
        return (ux + g * ax, uy + g * ay, uz + g * az)
