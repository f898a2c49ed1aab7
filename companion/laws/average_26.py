"""Eq. 26: followers average their neighbours, leaders track the reference alone. The paper compares its law with it."""

from __future__ import annotations

from companion.laws._neighbour_feedback import NeighbourFeedback


class Average26(NeighbourFeedback, frozen=True):
    """Average of all neighbours, without those of leaders."""

    @property
    def leader_uses_neighbours(self) -> bool:
        """A leader tracks the RFT alone."""
        return False
