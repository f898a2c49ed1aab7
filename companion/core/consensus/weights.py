"""Neighbour weights of Algorithm 2, with the exponent alpha of weights 1/p^alpha."""

from __future__ import annotations

from collections.abc import Sequence


def neighbour_weights(prcs: Sequence[int], exponent: float) -> list[float]:
    """w_ij = p_j^-alpha / sum_j p_j^-alpha for the neighbours' PrCs p_j >= 1, in their order.

    alpha = 1 is the paper's Algorithm 2, alpha = 0 the average of eq. 22. The weights add up to one. The list is empty
    without neighbours, where the paper's algorithm would divide by zero.
    """
    shares = [prc**-exponent for prc in prcs]
    total = sum(shares)
    return [share / total for share in shares]
