"""The neighbour set N_i: by explicit edges, or by range with hysteresis."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from math import dist
from typing import Protocol

from companion.types import Vector3


class NeighbourRule(Protocol):
    def select(self, own_position_enu_m: Vector3, positions_enu_m: Mapping[int, Vector3]) -> tuple[int, ...]:
        """The ids out of `positions_enu_m` that are neighbours now, in rising order."""


class EdgeRule:
    """Neighbours are the other ends of this vehicle's edges, as long as they are heard."""

    def __init__(self, own_id: int, edges: Iterable[tuple[int, int]]) -> None:
        self._others = sorted({b if a == own_id else a for a, b in edges if own_id in (a, b)})

    def select(self, own_position_enu_m: Vector3, positions_enu_m: Mapping[int, Vector3]) -> tuple[int, ...]:  # noqa: ARG002
        return tuple([i for i in self._others if i in positions_enu_m])


class RangeRule:
    """A vehicle joins within `range_m` and leaves beyond `range_m + hysteresis_m`; the set is remembered between calls."""

    def __init__(self, range_m: float, hysteresis_m: float) -> None:
        self._join_m = range_m
        self._leave_m = range_m + hysteresis_m
        self._members: frozenset[int] = frozenset()

    def select(self, own_position_enu_m: Vector3, positions_enu_m: Mapping[int, Vector3]) -> tuple[int, ...]:
        self._members = frozenset(
            i
            for i, position in positions_enu_m.items()
            if dist(own_position_enu_m, position) <= (self._leave_m if i in self._members else self._join_m)
        )
        return tuple(sorted(self._members))
