"""Eq. 22: equal weights for all neighbours, leaders coupled to theirs too. The paper compares its law with it."""

from __future__ import annotations

from companion.laws._neighbour_feedback import NeighbourFeedback


class Average22(NeighbourFeedback, frozen=True):
    """Eq. 22 of the paper: the plain mean of all neighbours, which a leader adds to its reference."""
