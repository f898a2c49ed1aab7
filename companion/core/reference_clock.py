"""How far into the RFT the fleet is. Every vehicle counts, so that one that takes the lead goes on and does not begin anew.

Time into the RFT is not the RFT: a follower that counts still knows nothing of where it leads.
"""

from __future__ import annotations

from companion.types import LeaderWord

# On average a packet waits half a tick before it is looked at; without this each change of the leader would lose as much.
WAITED_S = 0.01
FALLS_BACK_S = 1.0  # farther than the time is ever put right by: it begins anew


class ReferenceClock:
    """Seconds into the RFT by this vehicle's own clock. They run while a leader is in formation, and else they stand.

    A word of 0 says that its leader's time stands. Where the time stopped is about where the fleet stands since then: had it
    run on, the RFT would by now be away from there, and begun anew it would be where the flight began. Either is a leap of the
    reference for the next leader, so it goes on from there. Only who has landed begins anew.
    """

    def __init__(self) -> None:
        self._zero_s = 0.0  # when the RFT began
        self._counted_s = 0.0
        self.runs = False

    @property
    def has_run(self) -> bool:
        """Is it known how far into the RFT the fleet is? Not before formation, nor to an agent restarted in flight."""
        return self._counted_s > 0.0

    def update(self, now_s: float, in_formation: bool, word: LeaderWord | None, word_age_s: float) -> float:
        """A follower's, from the word of its leader; where it hears none, a time that runs goes on in formation."""
        if word is not None and word.reference_s > 0.0:
            self._zero_s = now_s - (word.reference_s + word_age_s + WAITED_S)
            return self._run(now_s)
        if word is None and in_formation and self.runs:
            return self._run(now_s)
        return self._stand(now_s)

    def lead(self, now_s: float, in_formation: bool, other: LeaderWord | None, other_age_s: float) -> float:
        """A leader's. It enters formation where another leader is by now, else where the time stands.

        In formation `other` is one that goes before: two that entered at once, of which one had landed, count one time as well.
        """
        if in_formation and (other is None or self._agrees(now_s, other, other_age_s)):
            return self._run(now_s)
        return self.update(now_s, in_formation, other, other_age_s)

    def _agrees(self, now_s: float, other: LeaderWord, other_age_s: float) -> bool:
        return other.reference_s == 0.0 or abs(other.reference_s + other_age_s - (now_s - self._zero_s)) < FALLS_BACK_S

    def begin_anew(self) -> None:
        self._counted_s, self.runs = 0.0, False

    def _run(self, now_s: float) -> float:
        self._counted_s, self.runs = now_s - self._zero_s, True
        return self._counted_s

    def _stand(self, now_s: float) -> float:
        self._zero_s, self.runs = now_s - self._counted_s, False
        return self._counted_s
