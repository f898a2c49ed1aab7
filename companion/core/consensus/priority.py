"""PrC, the priority coefficient p_i = hops to the nearest leader + 1 (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Iterable


def next_prc(is_leader: bool, neighbour_prcs: Iterable[int], n: int) -> int:
    """p_i(k+1) of Algorithm 1 (line 3 corrected: per[j] = p_j(k)).

    `n` is the number of vehicles; a follower without neighbours gets n, a leader 1.
    """
    if is_leader:
        return 1
    least = n
    for prc in neighbour_prcs:
        if prc < least:
            least = prc
    return min(n, least + 1)
