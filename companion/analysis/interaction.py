"""The laws of all vehicles as matrices: the interaction matrix G (eq. 6) and the figures of its spectrum and of the modes.

The flight core computes for one vehicle. This analysis covers the whole fleet, before a flight.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from functools import cached_property
from math import inf, log

import numpy as np
from numpy.typing import NDArray

from companion.analysis.linear_law import STATES
from companion.analysis.loop import Loop
from companion.analysis.network import LinearNetwork
from companion.analysis.response import TICK_S, Graph
from companion.laws import Law
from companion.laws._feedback_gains import feedback_gains
from companion.types.formation import Gains
from companion.types.values import Vector3

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class Coupling:
    """All vehicles under one law, in rising order of the ids.

    `own` (outputs, n, inputs) and `near` (outputs, inputs, n, n) are what linear_law.py says of each vehicle.
    """

    def __init__(self, network: LinearNetwork, leaders: Collection[int]) -> None:
        self.network, self.law, self.gains = network, network.law, feedback_gains(network.law)
        ids, law = network.ids, network.law
        column = {vehicle_id: index for index, vehicle_id in enumerate(ids)}
        self.prcs = np.array([network.prcs[i] for i in ids], dtype=np.int64)
        self.is_leader = np.array([i in leaders for i in ids], dtype=np.bool_)
        self.own: FloatArray = np.array([network.laws[i].own for i in ids]).transpose(1, 0, 2)
        self.near = np.zeros((network.width, STATES + law.publishes, len(ids), len(ids)))
        for i in ids:
            for j, rows in zip(network.neighbours[i], network.laws[i].neighbours, strict=True):
                self.near[:, :, column[i], column[j]] = rows

    @cached_property
    def _stacked(self) -> tuple[FloatArray, FloatArray]:
        """What all outputs get of all positions, velocities, accelerations and memories, and of published values."""
        (outputs, inputs, n, _), states = self.near.shape, self.own.shape[2]
        parts = [np.vstack([np.diag(rows[:, k]) for rows in self.own]) for k in range(states)]
        for k in range(STATES):
            parts[k] = parts[k] + self.near[:, k].reshape(-1, n)
        values = [self.near[:, k].reshape(-1, n) for k in range(STATES, inputs)]
        return np.hstack(parts), np.hstack(values) if values else np.zeros((outputs * n, 0))

    @cached_property
    def _static(self) -> FloatArray:
        """What acceleration and memories get, with what is published of it followed to those who use it, without its age."""
        total, values = self._stacked
        top = (1 + self.law.memory) * len(self.prcs)
        return np.asarray(total[:top] + values[:top] @ self._published)

    @cached_property
    def _published(self) -> FloatArray:
        total, values = self._stacked
        top = (1 + self.law.memory) * len(self.prcs)
        solved = np.linalg.solve(np.eye(len(total) - top) - values[top:], total[top:])
        return np.asarray(solved, dtype=np.float64)

    @property
    def published(self) -> FloatArray:
        """The values of vehicles at rest, over their displacements."""
        return self._published[:, : len(self.prcs)]

    @cached_property
    def loop(self) -> Loop:
        """The equations over frequency."""
        return Loop(self.network)

    @cached_property
    def spectrum(self) -> FloatArray:
        """`eigenvalues` of G."""
        return eigenvalues(self.G)

    @cached_property
    def G(self) -> FloatArray:  # noqa: N802 -- eq. 6
        """G (n, n) of eq. 6, of any law: minus what displaced vehicles at rest get, over k1 of the law."""
        n = len(self.prcs)
        return np.asarray(-self._static[:n, :n] / self.gains.position_1_s2 + 0.0)  # no -0.

    @cached_property
    def modes(self) -> ComplexArray:
        """Poles of the formation without attitude lag, delays and links, 1/s; memories as if they changed continuously."""
        linked = np.any(self.near != 0.0, axis=(0, 1))
        return np.concatenate([self._modes_of(group) for group in _groups(linked)])

    def _modes_of(self, group: NDArray[np.intp]) -> ComplexArray:
        """Poles of vehicles that all depend on each other."""
        n, asked, inputs = len(group), 1 + self.law.memory, STATES + self.law.memory
        blocks = self._static.reshape(asked, len(self.prcs), inputs, len(self.prcs))
        static = blocks[:, group][..., group].reshape(asked * n, inputs * n)
        static = static * np.tile(_scales(self.G[np.ix_(group, group)]), (asked, inputs))
        accelerations, others = static[:, 2 * n : 3 * n], np.delete(static, np.s_[2 * n : 3 * n], axis=1)
        commands = np.linalg.solve(np.eye(n) - accelerations[:n], others[:n])
        remembered = others[n:] + accelerations[n:] @ commands - np.eye(len(others[0]))[2 * n :]
        matrix = np.vstack([np.eye(n, len(others[0]), n), commands, remembered / TICK_S])
        return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)

    @cached_property
    def hands_on(self) -> float:
        """Largest pole of what laws hand on from tick to tick while all vehicles are held in their slots; 1 keeps its size."""
        (total, values), n, memory = self._stacked, len(self.prcs), self.law.memory
        top, near = (1 + memory) * n, self.near[:, STATES - 1].reshape(-1, n)
        tick = np.hstack([total[:, 2 * n :], values])
        now = tick[top:, :top].copy()  # what is published refers to this tick, but for accelerations of neighbours
        now[:, :n] -= near[top:]
        tick[top:, :top] = 0.0
        tick[top:, :n] = near[top:]
        tick[top:] += now @ tick[:top]
        return float(np.abs(np.linalg.eigvals(tick)).max())

    @property
    def rate_1_s(self) -> float:
        """Errors shrink like exp(-rate t) at last, without lag and delays; 0 where they do not."""
        return max(0.0, -float(self.modes.real.max()))

    @property
    def damping(self) -> float:
        """The smallest of all modes, without lag and delays; 1 is critical, and no mode has more."""
        return float((-self.modes.real / np.maximum(np.abs(self.modes), 1e-300)).min())


def couple(
    graph: Graph,
    leaders: Collection[int],
    law: Law,
    slots_enu_m: Mapping[int, Vector3] | None = None,
    drag_1_s: float = 0.0,
) -> Coupling:
    """Coupling of a graph under a law, with the PrCs of Algorithm 1."""
    return Coupling(LinearNetwork(graph, leaders, law, slots_enu_m, drag_1_s), leaders)


def interaction_matrix(
    graph: Graph, leaders: Collection[int], law: Law, slots_enu_m: Mapping[int, Vector3] | None = None
) -> FloatArray:
    """G (n x n) of eq. 6 under a law; rows and columns in rising order of the ids."""
    return couple(graph, leaders, law, slots_enu_m).G


def eigenvalues(matrix: FloatArray) -> FloatArray:
    """Real parts of the eigenvalues of G (n,), rising. Under the built-in laws they are real (Lemma 2).

    The chain of 100 needs the scales: a matrix this far from normal has eigenvalues anywhere, in floating point.
    """
    found = []
    for group in _groups(matrix != 0.0):
        block = matrix[np.ix_(group, group)]
        scaled = block * _scales(block)
        symmetric = np.allclose(scaled, scaled.T, rtol=0.0, atol=1e-13)
        found.append(np.linalg.eigvalsh(scaled) if symmetric else np.linalg.eigvals(scaled).real)
    return np.sort(np.concatenate(found))


def _groups(linked: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Vehicles that all depend on each other, by what links (n, n). Their poles are their own, whatever else they hear.

    With all of them at once, equal poles of two groups would be found to half the digits.
    """
    reached, known = linked | np.eye(len(linked), dtype=np.bool_), 0
    while known < (known := int(reached.sum())):
        reached = reached @ reached
    both = reached & reached.T
    return [np.flatnonzero(row) for i, row in enumerate(both) if row.argmax() == i]


def _scales(matrix: FloatArray) -> FloatArray:
    """q_j / q_i (n, n), times which a matrix is symmetric if any scales make it so: its eigenvalues stay the same.

    Lemma 2: the weights S^-1 A P of a graph with adjacency A, diagonal S and P, become symmetric by q = (P S)^-1/2.
    """
    logs, (linked, other) = np.full(len(matrix), np.nan), np.abs([matrix, matrix.T])
    for first in range(len(matrix)):
        waiting = [first] if np.isnan(logs[first]) else []
        logs[waiting] = 0.0
        while waiting:
            i = waiting.pop()
            for j in np.flatnonzero((linked[i] + other[i] > 0.0) & np.isnan(logs)):
                both = linked[i, j] > 0.0 and other[i, j] > 0.0
                logs[j] = logs[i] + (0.5 * log(other[i, j] / linked[i, j]) if both else 0.0)
                waiting.append(int(j))
    return np.asarray(np.exp(np.subtract.outer(-logs, -logs)), dtype=np.float64)


def time_to_shrink_s(rate_1_s: float, error_m: float, within_m: float) -> float:
    """Time in which an error decays to `within_m` at this rate, s. Longer if G is far from normal."""
    if error_m <= within_m:
        return 0.0
    return log(error_m / within_m) / rate_1_s if rate_1_s > 0.0 else inf


def shift_m(gains: Gains, velocity_error_m_s: float) -> float:
    """Distance from the slot with a constant velocity error, m."""
    return gains.velocity_1_s / gains.position_1_s2 * velocity_error_m_s


def share_left(rate_rad_s: float, bandwidth_1_s: float) -> float:
    """Share of a velocity error that turns at this rate which the correction leaves; 1 where it is off.

    The law rests where k1 times the position error balances k2 times the velocity error e: k2/k1 of e away. The correction
    (`core/estimation/corrections.py`) leaves of e what its filter lets pass: s (s + 2 w) / (s + w)^2 e. It acts on the
    difference of the autopilot's own position and velocity, and where both agree it is zero: in the linear model of law and
    correction together the poles are those of the law and twice -w, so it makes no formation unstable.
    """
    if bandwidth_1_s == 0.0:
        return 1.0
    s = 1j * rate_rad_s
    return abs(s * (s + 2.0 * bandwidth_1_s)) / abs(s + bandwidth_1_s) ** 2
