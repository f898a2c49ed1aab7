"""All vehicles of a formation as one linear loop, from the linearised law of each. Without numpy.

A vehicle is a double integrator with drag behind the lag of its attitude loop and a delay: with s = j omega, A = s^2 + c s,
H e^{-sd} of lag and delay, and z = e^{sT} of a tick, its displacement obeys A y = H e^{-sd} u. A law gives u, its memory and
its values; they are the unknowns beside y, memory and values times H e^{-sd}, so that no entry grows with s more than A does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import e
from typing import Any

from companion.analysis.linear_law import STATES, LinearLaw, linearised
from companion.analysis.response import TICK_S, Graph, LinearModel, settled_prcs
from companion.laws import Law
from companion.types.values import ZERO3, Vector3

TERMS = 11
PLANT, OLD_PLANT, LATE_PLANT, POSITION, VELOCITY, ACCELERATION, LATE_POSITION, LATE_VELOCITY, ONE, OLD, LATE = range(
    TERMS
)
OF_MOTION = (PLANT, OLD_PLANT, LATE_PLANT)
OF_STATE = (POSITION, VELOCITY, ACCELERATION, LATE_POSITION, LATE_VELOCITY)  # what loses its gain at high frequencies


def terms(s: Any, model: LinearModel) -> tuple[Any, ...]:
    """What coefficients multiply at a complex s, or at an array of them, in the order of the names above."""
    plant, flown = s * (s + model.drag_1_s), e ** (-s * model.delay_s) * model.flown_share(s)
    late, later = e ** (-s * model.neighbour_delay_s), e ** (-s * model.feedforward_delay_s)
    old, velocity = e ** (-s * TICK_S), flown * s
    states = (flown, velocity, velocity * s, flown * late, velocity * late)
    return (plant, plant * old, plant * later, *states, 1.0 + 0.0 * s, old, later)


Sum = list[tuple[int, float]]
"""Terms and their coefficients."""


@dataclass(frozen=True, slots=True)
class Equations:
    """Of a formation: the left side by row and column, the right side by row."""

    left: dict[int, dict[int, Sum]]
    right: dict[int, Sum]

    def subtract(self, row: int, column: int, which: Sequence[int], coefficients: Sequence[float]) -> None:
        """Terms of an entry with these coefficients."""
        found = [(term, -value) for term, value in zip(which, coefficients, strict=True) if value]
        if found:
            self.left[row].setdefault(column, []).extend(found)
            self.left[column].setdefault(row, [])


class LinearNetwork:
    """The law of every vehicle, by rising id, and their equations.

    Of each vehicle there are `width` unknowns in a row: displacement, memories after the tick, values.
    """

    def __init__(
        self,
        graph: Graph,
        leaders: Collection[int],
        law: Law,
        slots_enu_m: Mapping[int, Vector3] | None = None,
        drag_1_s: float = 0.0,
    ) -> None:
        self.formation = (graph, leaders)
        self.law, self.ids, self.prcs = law, sorted(graph), settled_prcs(graph, leaders)
        self.width = 1 + law.memory + law.publishes
        self.neighbours = {i: sorted(graph[i]) for i in self.ids}
        slots = slots_enu_m or dict.fromkeys(self.ids, ZERO3)
        self.laws: dict[int, LinearLaw] = {}
        for i in self.ids:
            around = self.neighbours[i]
            at = [slots[j] for j in (i, *around)]
            self.laws[i] = linearised(law, i in leaders, [self.prcs[j] for j in around], at, drag_1_s)

    @cached_property
    def equations(self) -> Equations:
        """Of all unknowns. An entry has its counterpart, which may be empty."""
        found = Equations({k: {} for k in range(len(self.ids) * self.width)}, {})
        first = {i: index * self.width for index, i in enumerate(self.ids)}
        for i in self.ids:
            self._add(found, first, i)
        return found

    def _add(self, equations: Equations, first: Mapping[int, int], i: int) -> None:
        """The equations of one vehicle."""
        subtract = equations.subtract
        linear, memory, row = self.laws[i], self.law.memory, first[i]
        for output in range(self.width):
            published = output > memory
            equations.left[row + output][row + output] = [(ONE if output else PLANT, 1.0)]
            states = (POSITION, VELOCITY, PLANT if published else OLD_PLANT)
            subtract(row + output, row, states, linear.own[output][:STATES])
            for k, coefficient in enumerate(linear.own[output][STATES:]):
                subtract(row + output, row + 1 + k, (ONE if published else OLD,), (coefficient,))
            for j, rows in zip(self.neighbours[i], linear.neighbours, strict=True):
                states = (LATE_POSITION, LATE_VELOCITY, LATE_PLANT)
                subtract(row + output, first[j], states, rows[output][:STATES])
                for k, coefficient in enumerate(rows[output][STATES:]):
                    subtract(row + output, first[j] + 1 + memory + k, (LATE,), (coefficient,))
            reference = zip((POSITION, VELOCITY, ACCELERATION), linear.reference[output], strict=True)
            equations.right[row + output] = [(term, value) for term, value in reference if value]

    @property
    def remarks(self) -> list[str]:
        """What the law says of its linearisation, each once."""
        return sorted({remark for linear in self.laws.values() for remark in linear.remarks})

    def responses(self, s: complex, model: LinearModel) -> dict[int, complex]:
        """y_i/r of each vehicle."""
        at, equations = terms(s, model), self.equations
        rows = {
            row: {column: sum([at[term] * value for term, value in found], 0j) for column, found in entries.items()}
            for row, entries in equations.left.items()
        }
        right = {row: sum([at[term] * value for term, value in found], 0j) for row, found in equations.right.items()}
        solution = solved(rows, right)
        return {i: solution[index * self.width] for index, i in enumerate(self.ids)}


def solved(rows: dict[int, dict[int, complex]], right: dict[int, complex]) -> dict[int, complex]:
    """Solution of a sparse system with a symmetric pattern, by elimination of the row with the fewest entries first."""
    left, order = set(rows), []
    while left:
        pivot = min(left, key=lambda i: len(rows[i]))
        left.discard(pivot)
        order.append(pivot)
        row = rows[pivot]
        diagonal = row[pivot]
        for i in row.keys() & left:
            other = rows[i]
            factor = other.pop(pivot) / diagonal
            for j, value in row.items():
                if j != pivot:
                    other[j] = other.get(j, 0j) - factor * value
            right[i] -= factor * right[pivot]
    solution: dict[int, complex] = {}
    for pivot in reversed(order):
        row = rows[pivot]
        rest = sum((value * solution[j] for j, value in row.items() if j != pivot), 0j)
        solution[pivot] = (right[pivot] - rest) / row[pivot]
    return solution
