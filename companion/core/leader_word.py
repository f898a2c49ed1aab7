"""The leader's word: how a vehicle knows that there is a living leader, which PrC alone never says.

With no leader in reach PrC climbs by one a tick and stays at n, and p = n is also legal at the end of a chain of n. So every
packet carries a word beside the PrC: who leads, and a stamp that only the leader itself moves on.
"""

from __future__ import annotations

from collections.abc import Iterable

from companion.types import LeaderWord, Term

HOPS_S = 10.0  # more than a tick for each hop through the largest fleet


class LeaderWatch:
    """When each leader's stamp last moved on, on this vehicle's own clock.

    Two followers that hear only each other pass the same stamp to and fro, and it does not get younger by that: each vehicle
    takes a stamp once. A word older than `max_age_s` is not passed on, so it is gone everywhere after `max_age_s` and a tick
    for each hop; well after that a leader may begin with smaller stamps again (its computer was started anew).
    """

    def __init__(self, max_age_s: float) -> None:
        self._max_age_s = max_age_s
        self._forget_s = 2.0 * max_age_s + HOPS_S
        self._newest: dict[int, tuple[LeaderWord, float]] = {}  # leader id -> newest word, when it came

    def hear(self, now_s: float, words: Iterable[LeaderWord | None], term: Term) -> None:
        """Words that neighbours passed on; those of leads before `term`, this vehicle's own, are not heeded."""
        for word in words:
            if word is None or word.term < term:
                continue
            newest = self._newest.get(word.leader_id)
            if newest is None or _later(word, newest[0]) or now_s - newest[1] > self._forget_s:
                self._newest[word.leader_id] = (word, now_s)

    def youngest(self, now_s: float) -> tuple[LeaderWord | None, float]:
        """The word to pass on and its age in seconds; None and infinity where no leader was heard within `max_age_s`.

        The newest lead comes first, and in it a leader that flies the RFT before one that does not. At a change the last word
        of the old one counts until it is too old: the new leader's is on its way.
        """
        ages = [(now_s - heard_s, word) for word, heard_s in self._newest.values()]
        living = [
            (word.term, word.reference_s > 0.0, -age_s, word.leader_id)
            for age_s, word in ages
            if age_s <= self._max_age_s
        ]
        if not living:
            return None, float("inf")
        _, _, minus_age_s, leader_id = max(living)
        return self._newest[leader_id][0], -minus_age_s


def _later(word: LeaderWord, than: LeaderWord) -> bool:
    return (word.term, word.stamp) > (than.term, than.stamp)
