"""PrC, the priority coefficient p_i = hops to the nearest leader + 1 (Algorithm 1), and the leader's word beside it.

With no leader in reach PrC climbs by one a tick and stays at n, and p = n is also legal at the end of a chain of n. So PrC
never says that there is a leader: the age of the leader's word does.
"""

from __future__ import annotations

from collections.abc import Iterable

from companion.types import LeaderWord


def next_prc(is_leader: bool, neighbour_prcs: Iterable[int], n: int) -> int:
    """p_i(k+1) of Algorithm 1 (line 3 corrected: per[j] = p_j(k)).

    `n` is the number of vehicles; a follower without neighbours gets n, a leader 1.
    """
    if is_leader:
        return 1
    return min(n, min(neighbour_prcs, default=n) + 1)


def next_leader_word(own_word: LeaderWord | None, heard: Iterable[LeaderWord | None]) -> LeaderWord | None:
    """The youngest word: a leader passes its own (age 0), a follower the youngest that its neighbours passed on.

    Ages only grow on the way, so nothing that circulates can ever look younger than it is.
    """
    if own_word is not None:
        return own_word
    return min((word for word in heard if word is not None), key=lambda word: word.age_s, default=None)
