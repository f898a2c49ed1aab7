"""Events of the safety filter: one when an intervention begins, however long it lasts or flickers."""

from __future__ import annotations

from math import inf

from companion.types.notices import Code, Notice
from companion.types.status import SeparationReport

REPORTED_M_S2 = 0.3  # smaller changes come and go with noise
ENDS_AFTER_S = 2.0  # without a change: then the next one is another intervention
PERIOD_S = 5.0  # at least, between two events


class Interventions:
    """Finds the beginning of each intervention."""

    def __init__(self) -> None:
        self._changed_s = -inf  # when the command was last changed by REPORTED_M_S2
        self._event_s = -inf

    def step(self, now_s: float, separation: SeparationReport) -> tuple[Notice, ...]:
        """An event in the tick in which an intervention begins."""
        if separation.changed_m_s2 < REPORTED_M_S2:
            return ()
        begins = now_s - self._changed_s > ENDS_AFTER_S and now_s - self._event_s > PERIOD_S
        self._changed_s = now_s
        if not begins:
            return ()
        self._event_s = now_s
        text = f"the filter of vehicles, obstacles and fence changes the acceleration by {separation.changed_m_s2:.1f} m/s^2"
        if nearest := separation.nearest:
            text += (
                f"; nearest vehicle: {nearest.name} at {nearest.distance_m:.2f} m, required {nearest.required_m:.2f} m"
            )
        return (Notice(Code.SEPARATION_INTERVENES, text),)
