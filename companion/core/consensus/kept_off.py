"""The RFT by which a vehicle flies that the separation filter keeps off its slot: published in place of its own offset.

The law compares positions minus slots. A vehicle that makes way for another one is off its slot for seconds, and its peers
would follow it: it would pull the whole formation aside, vehicles that wait for each other would not come apart, and they
would reach their slots late or never. So it publishes the RFT that the law gives it, as if it were in its slot.
"""

from __future__ import annotations

from math import dist, inf

from companion.core.consensus.law import FormationState

INTERVENES_M_S2 = 0.3  # less comes and goes with noise
LASTS_S = 3.0  # after the last intervention
BACK_WITHIN_M = 0.1  # of the slot: from there on its own position counts again
# So does it where the vehicle comes no nearer: on an RFT that moves, the law itself may lag more than that.
NEARER_M, NEARER_WITHIN_S = 0.02, 1.0


class KeptOff:
    """Whether this vehicle is kept off its slot."""

    def __init__(self) -> None:
        self._intervened_s = -inf
        self._is_kept_off = False
        self._nearest_m, self._nearer_s = inf, -inf  # on the way back, and when it came so near

    def intervened(self, now_s: float, taken_m_s2: float) -> bool:
        """Whether it is, or was and is not back yet. `taken_m_s2`: of the acceleration that the law wants, by vehicles."""
        if taken_m_s2 > INTERVENES_M_S2:
            self._intervened_s, self._is_kept_off, self._nearest_m = now_s, True, inf
        return self._is_kept_off

    def rft(self, now_s: float, own: FormationState, target: FormationState) -> FormationState | None:
        """The RFT to publish: that of the law. None from when this vehicle is back in its slot, or as near as it comes."""
        if now_s - self._intervened_s <= LASTS_S:
            return target
        off_m = dist(own.position_enu_m, target.position_enu_m)
        if off_m < self._nearest_m - NEARER_M:
            self._nearest_m, self._nearer_s = off_m, now_s
        if off_m < BACK_WITHIN_M or now_s - self._nearer_s > NEARER_WITHIN_S:
            self._is_kept_off = False
            return None
        return target

    def end(self) -> None:
        """Outside formation."""
        self._intervened_s, self._is_kept_off = -inf, False
