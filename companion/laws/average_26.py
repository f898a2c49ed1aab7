"""Eq. 26: followers average their neighbours, leaders track the reference alone. The paper compares its law with it."""

from __future__ import annotations

from companion.laws._neighbour_feedback import NeighbourFeedback


class Average26(NeighbourFeedback, frozen=True):
    """Eq. 26 of the paper: the plain mean of all neighbours; a leader follows its reference alone."""

    @property
    def leader_uses_neighbours(self) -> bool:
        """A leader tracks the RFT alone."""
        return False
