"""Formation laws. A law is one pure class; each module here that does not begin with `_` is one, under its own name.

A law gives the acceleration of one vehicle from its own state and what it knows of its neighbours. Its fields are its
parameters, with their bounds: `law.parameters` of a fleet file sets them. Everything below it stays as it is under any law:
the separation filter, the limits of tilt and thrust, the failsafes.

States are those of eq. 14: positions minus slots. In perfect formation all of them equal the RFT, and a law steers the
differences to zero. So a law that uses differences alone does not depend on where in the world, or in which formation, it
flies. Vectors are tuples (x, y, z) of floats, ENU. In a batch (`sitl compare`) each float is an array, one value for each of
many vehicles: a law that is written with + - * / flies there as it is, another one vehicle by vehicle.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Annotated, Any, ClassVar

from msgspec import Meta, Struct

from companion.types.formation import FormationState
from companion.types.peers import MOST_VALUES
from companion.types.values import ZERO3, Vector3

__all__ = [
    "MOST_VALUES",
    "FormationState",
    "Gain",
    "Law",
    "Memory",
    "Neighbour",
    "Own",
    "Values",
    "batch_weights",
    "neighbour_weights",
]

Gain = Annotated[float, Meta(gt=0, le=10)]
Memory = tuple[Vector3, ...]
"""What a law remembers from one tick to the next, one vector each."""
Values = tuple[Vector3, ...]
"""What a vehicle publishes of its own to its neighbours, one vector each."""


class Own(FormationState, frozen=True, gc=False):
    """What a law knows of its own vehicle.

    `acceleration_enu_m_s2` is what was commanded last. `slot_enu_m` is the slot d_i0, relative to the RFT. `drag_1_s` is the
    deceleration by drag per m/s. `step_s` is the time since the position before, 0.02 s unless one was missed. `memory` is
    what `remember` returned at that position, and zeros at the first one in formation.
    """

    slot_enu_m: Vector3 = ZERO3
    drag_1_s: float = 0.0
    step_s: float = 0.02
    memory: Memory = ()


class Neighbour(FormationState, frozen=True, gc=False):
    """What a law knows of a neighbour, extrapolated to now.

    `prc` is its priority coefficient: hops to the nearest leader, plus one. `slot_enu_m` is its slot d_j0. `age_s` is how old
    the received state is. `values` are those that the law of the neighbour published, as old as the state and not
    extrapolated; zeros before the neighbour is in formation.
    """

    prc: int = 1
    slot_enu_m: Vector3 = ZERO3
    age_s: float = 0.0
    values: Values = ()


class Law(Struct, frozen=True, forbid_unknown_fields=True):
    """Base of all laws. `memory` and `publishes`: how many vectors it remembers, and how many a vehicle publishes.

    `weighs`: a neighbour counts with its weight of `batch_weights` alone, so one with an infinite PrC does not count. A batch
    asks such a law about vehicles with different numbers of neighbours at once.

    All methods are pure: the same arguments give the same result, and nothing else is read or kept. `reference` is
    R = [r, r', r''] for a leader, None for a follower; a follower may have no neighbours at all.
    """

    memory: ClassVar[int] = 0
    publishes: ClassVar[int] = 0
    weighs: ClassVar[bool] = False

    def acceleration(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Vector3:
        """The wanted acceleration u_i, m/s^2 in ENU. An exception, or a result that is not finite, ends the agent."""
        raise NotImplementedError

    def remember(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Memory:  # noqa: ARG002
        """The memory for the next position. Called after `acceleration`, where `memory` is not 0."""
        return own.memory

    def publish(self, own: Own, neighbours: Sequence[Neighbour], reference: FormationState | None) -> Values:  # noqa: ARG002
        """The values for the neighbours. Called after `acceleration`, where `publishes` is not 0."""
        return ()

    def near_formation(self) -> Law:
        """The law that analysis linearises in place of this one: itself, unless it has no linearisation where it settles."""
        return self

    def weights(self, leads: bool, prcs: Sequence[int]) -> tuple[float, ...]:  # noqa: ARG002
        """w_ij of neighbours with these PrCs, in their order, for status and for a vehicle that the filter keeps off its slot.

        They add up to one, or are empty: of a leader that uses no neighbours, and of a law whose weights are not of PrCs alone.
        """
        return ()


@lru_cache(maxsize=256)  # PrCs change seldom, and every tick needs their weights
def neighbour_weights(prcs: tuple[int, ...], exponent: float = 1.0, ratio: float = 1.0) -> tuple[float, ...]:
    """w_ij = s_j / sum_j s_j with the shares s_j = ratio^p_j / p_j^exponent of neighbours with PrCs p_j >= 1, in their order.

    Exponent 1 and ratio 1 is the paper's Algorithm 2, exponent 0 and ratio 1 the average of eq. 22. A power is sharp between
    the first hops and nearly flat behind twenty: a vehicle there would follow its own followers. A ratio rho < 1 (0 < rho) is
    as sharp at every hop: of two neighbours at p - 1 and p + 1 the second has rho^2 times the weight of the first.

    The weights add up to one. There are none without neighbours, where the paper's algorithm would divide by zero.
    """
    # rho^p of the 160th hop is below the smallest float, so hops are counted from the nearest neighbour.
    shares = _shares(prcs, exponent, ratio, min(prcs, default=1))
    total = sum(shares)
    return tuple([share / total for share in shares])


def batch_weights(prcs: Sequence[Any], exponent: float = 1.0, ratio: float = 1.0) -> tuple[Any, ...]:
    """`neighbour_weights` of many vehicles at once: the PrC of each neighbour is an array, infinite where there is none."""
    if not prcs:
        return ()
    from numpy import isinf, minimum, where  # no agent loads numpy for it

    absent = isinf(prcs)
    counted = list(where(absent, 1.0, prcs))  # with a weight of zero
    shares = _shares(counted, exponent, ratio, minimum.reduce(list(prcs)))
    shares = [where(none, 0.0, share) for none, share in zip(absent, shares, strict=True)]
    total = sum(shares)
    total = where(total > 0.0, total, 1.0)
    return tuple([share / total for share in shares])


def _shares(prcs: Sequence[Any], exponent: float, ratio: float, least: Any) -> list[Any]:
    return [prc**-exponent * ratio ** (prc - least) for prc in prcs]
