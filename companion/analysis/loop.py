"""The equations of a formation as arrays over frequency: responses, and the pivots whose product is the determinant."""

from __future__ import annotations

from collections.abc import Collection
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from companion.analysis.network import (
    LATE_POSITION,
    LATE_VELOCITY,
    OF_MOTION,
    OF_STATE,
    PLANT,
    POSITION,
    TERMS,
    VELOCITY,
    LinearNetwork,
    Sum,
    terms,
)
from companion.analysis.response import LinearModel

AT_ORIGIN_1_S = 2.0  # (s + AT_ORIGIN_1_S)^2 makes each displacement finite at all frequencies


class Loop:
    """Entries of all equations, and the order of their elimination, that with the fewest entries first.

    A pivot is the determinant of an unknown among those before it, with all others held at zero: it turns as slowly with the
    frequency as one vehicle does, where the determinant turns as fast as all together. Only what is filled is touched: O(n) at
    a frequency for a chain, not O(n^3).
    """

    def __init__(self, network: LinearNetwork) -> None:
        left, right, self._width = network.equations.left, network.equations.right, network.width
        order = _elimination(left, [row for row, found in right.items() if found])
        pairs = [pair for pivot, others in order for pair in _touched(pivot, others)]
        place = {pair: k for k, pair in enumerate(pairs)}
        self._rows, self._columns = np.array(pairs).T
        self._moves = self._columns % self._width == 0
        self._coefficients = _coefficients([left[row].get(column, []) for row, column in pairs])
        self._right = _coefficients([right[row] for row in range(len(left))])
        self._pivots = [place[pivot, pivot] for pivot, _ in order]
        self._steps = [
            (
                place[pivot, pivot],
                [place[row, pivot] for row in others],
                [place[pivot, column] for column in others],
                np.array([[place[row, column] for column in others] for row in others]),
            )
            for pivot, others in order
            if others
        ]

    def response(self, omega_rad_s: float, model: LinearModel) -> NDArray[np.complex128]:
        """y (n,) for a reference that oscillates by 1 m at this frequency."""
        at = np.array(terms(1j * omega_rad_s, model))
        matrix = np.zeros((len(self._right), len(self._right)), dtype=np.complex128)
        matrix[self._rows, self._columns] = self._coefficients @ at
        return np.asarray(np.linalg.solve(matrix, self._right @ at)[:: self._width], dtype=np.complex128)

    def pivots(self, omega_rad_s: NDArray[np.float64], model: LinearModel) -> NDArray[np.complex128]:
        """At these frequencies (k, unknowns)."""
        return self._eliminated(omega_rad_s, np.array(terms(1j * omega_rad_s, model)))

    def pivots_without_gain(self, omega_rad_s: NDArray[np.float64], model: LinearModel) -> NDArray[np.complex128]:
        """What laws hand on to each other: as where a vehicle cannot follow a command, and over A of its own motion."""
        s = 1j * omega_rad_s
        at = np.array(terms(s, model))
        at[list(OF_MOTION)] *= (s + AT_ORIGIN_1_S) ** 2 / at[PLANT]
        at[list(OF_STATE)] = 0.0
        return self._eliminated(omega_rad_s, at)

    @cached_property
    def gains(self) -> tuple[float, float, float]:
        """Row sums at most: of what is fed back from positions and velocities, and of what is handed on."""
        sizes = np.zeros((len(self._right), TERMS))
        np.add.at(sizes, self._rows, np.abs(self._coefficients))
        position, velocity = sizes[:, [POSITION, LATE_POSITION]], sizes[:, [VELOCITY, LATE_VELOCITY]]
        handed_on = sizes.sum(axis=1) - position.sum(axis=1) - velocity.sum(axis=1) - 1.0
        return float(position.sum(axis=1).max()), float(velocity.sum(axis=1).max()), float(handed_on.max())

    def _eliminated(self, omega_rad_s: NDArray[np.float64], at: NDArray[np.complex128]) -> NDArray[np.complex128]:
        values = self._coefficients @ at
        values[self._moves] /= (1j * omega_rad_s + AT_ORIGIN_1_S) ** 2
        for pivot, below, beside, rest in self._steps:
            values[rest] -= (values[below] / values[pivot])[:, np.newaxis] * values[beside]
        return np.asarray(values[self._pivots].T, dtype=np.complex128)


def _elimination(left: dict[int, dict[int, Sum]], last: Collection[int]) -> list[tuple[int, list[int]]]:
    """The unknowns in order, each with those that its elimination touches."""
    filled, order = {row: set(entries) - {row} for row, entries in left.items()}, []
    while filled:
        pivot = min(filled, key=lambda row: (row in last, len(filled[row])))
        others = filled.pop(pivot)
        for row in others:
            filled[row] |= others
            filled[row] -= {row, pivot}
        order.append((pivot, sorted(others)))
    return order


def _touched(pivot: int, others: list[int]) -> list[tuple[int, int]]:
    return [(pivot, pivot), *((row, pivot) for row in others), *((pivot, column) for column in others)]


def _coefficients(sums: list[Sum]) -> NDArray[np.float64]:
    found = np.zeros((len(sums), TERMS))
    for row, parts in zip(found, sums, strict=True):
        for term, value in parts:
            row[term] += value
    return found
