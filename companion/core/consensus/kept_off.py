"""The RFT that a vehicle publishes while the separation filter keeps it off its slot."""

from __future__ import annotations

from collections.abc import Sequence
from math import dist, inf

from companion.laws import FormationState, Law, Neighbour, neighbour_weights


def target(law: Law, neighbours: Sequence[Neighbour], reference: FormationState | None) -> FormationState | None:
    """The RFT that the law steers to: R of a leader, of a follower the weighted mean of its neighbours; None without any.

    A law that tells no weights counts with those of Algorithm 2.
    """
    if reference is not None or not neighbours:
        return reference
    prcs = [neighbour.prc for neighbour in neighbours]
    weights = law.weights(False, prcs) or neighbour_weights(tuple(prcs))
    states = [(s.position_enu_m, s.velocity_enu_m_s, s.acceleration_enu_m_s2) for s in neighbours]
    means = [
        tuple([sum(w * vector[axis] for w, vector in zip(weights, vectors, strict=True)) for axis in range(3)])
        for vectors in zip(*states, strict=True)
    ]
    return FormationState(*means)


INTERVENES_M_S2 = 0.3  # a smaller intervention comes and goes with noise
LASTS_S = 3.0  # the vehicle counts as kept off for this time after the last intervention
BACK_WITHIN_M = 0.1  # this near to its slot, a vehicle publishes its own position again
# So does it where the vehicle comes no nearer: on an RFT that moves, the law itself may lag more than that.
NEARER_M, NEARER_WITHIN_S = 0.02, 1.0


class KeptOff:
    """Whether the separation filter keeps this vehicle off its slot, and the RFT that it publishes in place of its own offset.

    The law compares positions minus slots. A vehicle that makes way for another one is off its slot for seconds, and its peers
    would follow it: it would pull the whole formation aside, vehicles that wait for each other would not come apart, and they
    would reach their slots late or never. So it publishes the RFT that the law gives it, as if it were in its slot.
    """

    def __init__(self) -> None:
        self._intervened_s = -inf
        self.is_kept_off = False
        # Least distance from the slot on the way back, and when it was reached.
        self._nearest_m, self._nearer_s = inf, -inf

    def intervened(self, now_s: float, taken_m_s2: float) -> bool:
        """Whether it is, or was and is not back yet. `taken_m_s2`: of the acceleration that the law wants, by vehicles."""
        if taken_m_s2 > INTERVENES_M_S2:
            self._intervened_s, self.is_kept_off, self._nearest_m = now_s, True, inf
        return self.is_kept_off

    def rft(self, now_s: float, own: FormationState, target: FormationState) -> FormationState | None:
        """The RFT to publish: that of the law. None from when this vehicle is back in its slot, or as near as it comes."""
        if now_s - self._intervened_s <= LASTS_S:
            return target
        off_m = dist(own.position_enu_m, target.position_enu_m)
        if off_m < self._nearest_m - NEARER_M:
            self._nearest_m, self._nearer_s = off_m, now_s
        if off_m < BACK_WITHIN_M or now_s - self._nearer_s > NEARER_WITHIN_S:
            self.is_kept_off = False
            return None
        return target

    def end(self) -> None:
        """Outside formation."""
        self._intervened_s, self.is_kept_off = -inf, False
