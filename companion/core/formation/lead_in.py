"""Lead-in: a leader whose RFT is not where the fleet flies adds rho(t), which begins at the difference and decays to zero.

A successor of a lost leader, a leader that comes back from hold, and a fleet that lags behind a fast RFT have this
difference. Without rho the law would fly it at once, in a step as large as the difference.
"""

from __future__ import annotations

from math import hypot

from companion.core.consensus.law import FormationState
from companion.core.formation.paths import Offset, Path, gentle_path
from companion.geometry.vectors import minus, plus
from companion.types.notices import Refused


class LeadIn:
    """rho of this vehicle while it is leader in formation. It depends on its own clock alone."""

    def __init__(self, speed_m_s: float, law_within_m: float) -> None:
        """`speed_m_s` limits what rho adds; up to `law_within_m` the law alone settles the difference."""
        self._speed_m_s = speed_m_s
        self._law_within_m = law_within_m
        self._path: Path | None = None
        self._begun_s = 0.0

    def begin(self, now_s: float, fleet: FormationState, reference: FormationState) -> None:
        """Begin at `fleet`, the RFT as the fleet flies it now. `reference` is R of this vehicle."""
        offset = Offset(
            minus(fleet.position_enu_m, reference.position_enu_m),
            minus(fleet.velocity_enu_m_s, reference.velocity_enu_m_s),
        )
        self._path, self._begun_s = None, now_s
        if offset.distance_m > self._law_within_m or hypot(*offset.velocity_m_s) > self._speed_m_s:
            try:
                self._path = gentle_path(offset, self._speed_m_s)
            except Refused:  # the guidance stage lets no vehicle lead from so far away
                return

    def end(self) -> None:
        self._path = None

    def added(self, now_s: float, reference: FormationState) -> FormationState:
        """R + rho."""
        if self._path is None:
            return reference
        delta, lasts_s = self._path
        elapsed_s = now_s - self._begun_s
        if elapsed_s >= lasts_s:
            self._path = None
            return reference
        position, velocity, acceleration = delta(elapsed_s)
        return FormationState(
            plus(reference.position_enu_m, position),
            plus(reference.velocity_enu_m_s, velocity),
            plus(reference.acceleration_enu_m_s2, acceleration),
        )
