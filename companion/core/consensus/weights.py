"""Neighbour weights of Algorithm 2, and weights that fall faster with the hops to the leader."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True, slots=True)
class Weighting:
    """How the share of a neighbour falls with its PrC p: as ratio^p / p^exponent.

    Exponent 1 and ratio 1 is the paper's Algorithm 2, exponent 0 and ratio 1 the average of eq. 22. A power is sharp between
    the first hops and nearly flat behind twenty: a vehicle there would follow its own followers. A ratio rho < 1 (0 < rho) is
    as sharp at every hop: of two neighbours at p - 1 and p + 1 the second has rho^2 times the weight of the first.
    """

    exponent: float = 1.0
    ratio: float = 1.0


def neighbour_weights(prcs: Sequence[int], weighting: Weighting) -> tuple[float, ...]:
    """w_ij = s_j / sum_j s_j with the shares s_j of neighbours with PrCs p_j >= 1, in their order.

    The weights add up to one. There are none without neighbours, where the paper's algorithm would divide by zero.
    """
    return _weights(tuple(prcs), weighting.exponent, weighting.ratio)


@lru_cache(maxsize=256)  # PrCs change seldom, and every tick needs their weights
def _weights(prcs: tuple[int, ...], exponent: float, ratio: float) -> tuple[float, ...]:
    # rho^p of the 160th hop is below the smallest float, so hops are counted from the nearest neighbour.
    least = min(prcs, default=1)
    shares = [prc**-exponent * ratio ** (prc - least) for prc in prcs]
    total = sum(shares)
    return tuple([share / total for share in shares])
