"""Serial consensus: J. Hansson and E. Tegling, "Closed-loop design for scalable performance of vehicular formations",
arXiv 2402.15208 (2024).

Two consensus laws of first order, one behind the other: u = -(L1 + L2) x' - L2 L1 x + u_ref for double integrators, so that
x'' + (L1 + L2) x' + L2 L1 x = u_ref, with two weighted graph Laplacians. The abstract claims stability where both graphs have
a spanning tree, and a bound on the worst transient that depends neither on the number of vehicles nor on the graph. The
theorem itself, gains and figures could not be read; the equation was read at second hand.

Here L1 = a M and L2 = b M, both of the neighbour graph: (M y)_i = y_i - sum_j w_ij y_j of a follower, y_i - r of a leader. A
vehicle publishes a (M y)_i, which makes L2 L1 x of two hops known over one: s_j = v_j + a (M y)_j of a neighbour. So s is as
new as its velocity, which is extrapolated, and the zeros of a vehicle that has not published yet say that it is where its own
neighbours are.
"""

from __future__ import annotations

from collections.abc import Sequence

from companion.laws import FormationState, Gain, Law, Neighbour, Own, Values, batch_weights, neighbour_weights
from companion.laws._followed import followed, weighted_mean
from companion.laws.weighted import Share, WeightRatio
from companion.types.values import ZERO3, Vector3


class Serial(Law, frozen=True):
    """Serial consensus of Hansson and Tegling: the largest transient does not grow with the number of vehicles.

    u_i = -a (v_i - sum_j w_ij v_j) - b (s_i - sum_j w_ij s_j) + g sum_j w_ij u_j, with s_i = v_i + a (M y)_i. A leader
    has R alone in place of its neighbours. About one neighbour K = [a b, a + b], which is never underdamped.

    inner_rate_1_s: a, with which a vehicle closes up to its neighbours
    outer_rate_1_s: b, with which it comes to that motion; the bound needs it clearly different from a
    weight_ratio: rho of the weights rho^p; 1 is the average of all neighbours
    feedforward: share of the neighbours' acceleration that a follower adds; 0 is the published law
    """

    publishes = 1

    inner_rate_1_s: Gain = 1.0
    outer_rate_1_s: Gain = 2.0
    weight_ratio: WeightRatio = 0.03
    feedforward: Share = 0.98

    def weights(self, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:
        """Empty for a leader, which tracks the RFT alone."""
        if leads:
            return ()
        try:
            return neighbour_weights(tuple(prcs), 0.0, self.weight_ratio)
        except TypeError:  # arrays have no hash
            return batch_weights(prcs, 0.0, self.weight_ratio)

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """Zero for a follower without neighbours."""
        weights = self.weights(reference is not None, [neighbour.prc for neighbour in neighbours])
        target = followed(own, neighbours, weights, reference)
        if target is None:
            return ZERO3
        k1, k2 = self.inner_rate_1_s * self.outer_rate_1_s, self.inner_rate_1_s + self.outer_rate_1_s
        b, g = self.outer_rate_1_s, self.feedforward if reference is None else 1.0
        bx, by, bz = (
            weighted_mean(weights, [neighbour.values[0] for neighbour in neighbours]) if reference is None else ZERO3
        )
        (x, y, z), (tx, ty, tz) = own.position_enu_m, target.position_enu_m
        (vx, vy, vz), (tvx, tvy, tvz) = own.velocity_enu_m_s, target.velocity_enu_m_s
        ax, ay, az = target.acceleration_enu_m_s2
        return (
            -k1 * (x - tx) - k2 * (vx - tvx) + b * bx + g * ax,
            -k1 * (y - ty) - k2 * (vy - tvy) + b * by + g * ay,
            -k1 * (z - tz) - k2 * (vz - tvz) + b * bz + g * az,
        )

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:
        """A (M y)_i, m/s; zero for a follower without neighbours."""
        weights = self.weights(reference is not None, [neighbour.prc for neighbour in neighbours])
        target = followed(own, neighbours, weights, reference)
        if target is None:
            return (ZERO3,)
        a, (x, y, z), (tx, ty, tz) = self.inner_rate_1_s, own.position_enu_m, target.position_enu_m
        return ((a * (x - tx), a * (y - ty), a * (z - tz)),)
