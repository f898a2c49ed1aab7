"""How far into the RFT the fleet is. Every vehicle counts, so that one that takes the lead goes on and does not begin anew.

Time into the RFT is not the RFT: a follower that counts still knows nothing of where it leads.
"""

from __future__ import annotations

from companion.types import LeaderWord

# On average a packet waits half a tick before it is looked at; without this each change of the leader would lose as much.
WAITED_S = 0.01


class ReferenceClock:
    """Seconds into the RFT by this vehicle's own clock. They stand at 0 until a leader is in formation."""

    def __init__(self) -> None:
        self._zero_s = 0.0  # when the RFT began

    def update(self, now_s: float, in_formation: bool, word: LeaderWord | None, word_age_s: float) -> float:
        """A follower's, from the word of its leader; where it hears none it goes on counting."""
        if word is None and in_formation:
            return now_s - self._zero_s
        runs = word is not None and word.reference_s > 0.0
        self._zero_s = now_s - (word.reference_s + word_age_s + WAITED_S if word is not None and runs else 0.0)
        return now_s - self._zero_s

    def lead(self, now_s: float, in_formation: bool, other: LeaderWord | None, other_age_s: float) -> float:
        """A leader's. It enters formation where another leader is by now, else at the beginning."""
        if in_formation:
            return now_s - self._zero_s
        self.update(now_s, in_formation, other, other_age_s)
        return 0.0
