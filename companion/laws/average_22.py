"""Eq. 22: equal weights for all neighbours, leaders coupled to theirs too. The paper compares its law with it."""

from __future__ import annotations

from companion.laws._neighbour_feedback import NeighbourFeedback


class Average22(NeighbourFeedback, frozen=True):
    """Average of all neighbours."""
